"""Files of segments: segments.csv, segments.jsonl, HumanML3D's texts/."""

import math
from fractions import Fraction
from pathlib import Path

import pytest

from dancedata.core.errors import DataError, SourceError
from dancedata.core.segments import CLIP_END, Layer, Segment
from dancedata.files.segment_files import read_segment_file, write_segment_file
from dancedata.formats.humanml_texts import Caption, plain_tokens, read_texts, texts_file
from tests.messages import raises_message

WORDS = Layer("description", language="en", author="A", licence="CC0", citation="c", sided="no")
MOVES = Layer(
    "moves", mirror=(("left turn", "right turn"),), sided="mirrored", units=(("left turn", "degrees"),),
)  # fmt: skip
EVENTS = Layer("marks", kind="instant", by="me 1")
ALL = [
    Segment(WORDS, Fraction(1, 3), Fraction(5, 2), texts=("waves; greets, «élan»", "= second")),
    Segment(WORDS, Fraction(0), CLIP_END, texts=('"quoted"\nand a new line',), tokens=("quoted/ADJ",)),
    Segment(MOVES, Fraction(-1), Fraction(2), "left turn", ("to the left",), ("to the right",), value=-90.5, joint=4),
    Segment(MOVES, Fraction(2), Fraction(3), "spin", other="b", whole=True, data={"m": 1.5, "n": [1]}),
    Segment(EVENTS, Fraction(7, 4), Fraction(7, 4), "hit"),
]


@pytest.mark.parametrize("name", ["s.csv", "s.jsonl"])
def test_what_is_written_is_read_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    assert write_segment_file(path, [("a", ALL[:3]), ("b", ALL[3:])]) == 5
    rows = read_segment_file(path)
    assert [row.clip for row in rows] == ["a", "a", "a", "b", "b"]
    for row, segment in zip(rows, ALL, strict=True):
        assert repr(row.segment) == repr(segment)  # nan is not equal to itself


@pytest.mark.parametrize("name", ["s.csv", "s.jsonl"])
def test_a_file_without_segments(tmp_path: Path, name: str) -> None:
    assert write_segment_file(tmp_path / name, []) == 0
    if name == "s.jsonl":
        assert read_segment_file(tmp_path / name) == []


def read(tmp_path: Path, text: str, name: str = "segments.csv", **more: str) -> list[Segment]:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8", newline="")
    return [row.segment for row in read_segment_file(path, **more)]


def test_semicolons_byte_order_marks_comments_and_frames(tmp_path: Path) -> None:
    text = "\ufeff# mine\r\nclip;start;end;fps;layer;text\r\na;45;90;29.97;w;hello, you\r\n\r\na;0;end;;w;all\r\n"
    first, second = read(tmp_path, text, language="de")
    assert (first.start, first.end) == (Fraction(4500, 2997), Fraction(9000, 2997))
    assert first.texts == ("hello, you",)
    assert first.layer == Layer("w", language="de")
    assert second.end == CLIP_END


def test_rows_without_an_end_are_instants(tmp_path: Path) -> None:
    (one,) = read(tmp_path, "clip,start,layer\na,1.25,mark\n")
    assert (one.layer.kind, one.end, one.joint, math.isnan(one.value)) == ("instant", Fraction(5, 4), -1, True)
    (two,) = read(tmp_path, "clip,start,end,kind,layer\na,1,1,instant,mark\n")
    assert two.layer.kind == "instant"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "clip,start,end\na,1,2\n",
        "clip,start,end,layer,txet\na,1,2,w,x\n",
        "clip,start,end,layer\na,1,2\n",
        "clip,start,end,layer\n,1,2,w\n",
        "clip,start,end,layer\na,1.5.2,2,w\n",
        "clip,start,end,layer\na,2,1,w\n",
        "clip,start,end,layer\na,0,99999999,w\n",
        "clip,start,end,layer,texts\na,1,2,w,plain\n",
        "clip,start,end,layer,texts,text\na,1,2,w,\"[\"\"a\"\"]\",b\n",
        "clip,start,end,layer,text,texts_mirrored\na,1,2,w,t,\"[\"\"a\"\",\"\"b\"\"]\"\n",
        "clip,start,end,layer,licence\na,1,2,w,CC0\na,2,3,w,CC-BY\n",
        "clip,start,end,layer\na,1,2,w\na,3,,w\n",
        "clip,start,end,layer,value\na,1,2,w,fast\n",
        "clip,start,end,layer,joint\na,1,2,w,1.5\n",
        "clip,start,end,layer,joint\na,1,2,w,99999999999999\n",
        "clip,start,end,layer,sided\na,1,2,w,perhaps\n",
        "clip,start,end,layer,whole\na,1,2,w,yes\n",
        'clip,start,end,layer\na,1,"2,w\n',
    ],
)  # fmt: skip
def test_mistakes_are_named_with_their_line(tmp_path: Path, text: str) -> None:
    if text:
        with raises_message(SourceError, "segments"):
            read(tmp_path, text)
    else:
        assert read(tmp_path, text) == []


@pytest.mark.parametrize(
    "row",
    [
        '{"clip": "a", "start": 1, "layer": "w"',
        "[1]",
        '{"clip": "a", "start": true, "end": 2, "layer": "w"}',
        '{"clip": "a", "start": 1, "end": 2, "layer": "w", "texts": "one"}',
        '{"clip": "a", "start": 1, "end": 2, "layer": "w", "data": [1]}',
        '{"clip": 7, "start": 1, "end": 2, "layer": "w"}',
        *(
            '{"clip": "a", "start": 1, "end": 2, "layer": "w", ' + f"{cell}}}"
            for cell in ('"label": "\\ud800"', '"text": "\\ud800"', '"data": {"\\udfff": 1}', '"author": "x\\udc00"')
        ),
        '{"clip": "a", "start": 1, "end": 2, "layer": "\\ud800"}',
    ],
)
def test_mistakes_in_jsonl(tmp_path: Path, row: str) -> None:
    with raises_message(SourceError, "correct", where="segments.jsonl, line 2"):
        read(tmp_path, f"\n{row}\n", "segments.jsonl")


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "segments.csv").write_bytes(b"\xff\xfe\x00")
    with raises_message(SourceError, "UTF-8", where="segments.csv"):
        read_segment_file(tmp_path / "segments.csv")


def test_captions_of_one_span_are_alternatives(tmp_path: Path) -> None:
    path = tmp_path / "000001.txt"
    path.write_text(
        "a man turns left.#a/DET man/NOUN turn/VERB left/ADJ#0.0#0.0\n"
        "he spins#he/PRON spin/VERB#0.0#0.0\n\n"
        "walks # twice#walk/VERB#nan#nan\n"
        "jumps#jump/VERB#1.5#3.25\n"
    )
    whole, part = read_texts(path, WORDS)
    assert (whole.start, whole.end) == (0, CLIP_END)
    assert whole.texts == ("a man turns left.", "he spins", "walks # twice")
    assert whole.tokens[1] == "he/PRON spin/VERB"
    assert (part.start, part.end, part.texts) == (Fraction(3, 2), Fraction(13, 4), ("jumps",))


@pytest.mark.parametrize("line", ["no parts", "a#b#1", "x#y#2#1", "x#y#one#2", "#y#0#0", "x#y#-1#2", "x#y#0#inf"])
def test_lines_that_are_not_captions(tmp_path: Path, line: str) -> None:
    (tmp_path / "n.txt").write_text(f"fine#f/ADJ#0#0\n{line}\n")
    with raises_message(DataError, "caption", where="n.txt, line 2", reason="bad_segment"):
        read_texts(tmp_path / "n.txt", WORDS)


def test_captions_are_written_as_the_loaders_split_them() -> None:
    first = Caption("a # b\nc", "a/X b/X", Fraction(0), Fraction(0))
    text = texts_file([first, Caption("d", "d/X", Fraction(1, 2), Fraction(2))])
    assert text == "a b c#a/X b/X#0.0#0.0\nd#d/X#0.5#2.0\n"
    # As HumanML3D's loader does.
    caption, tokens, start, end = text.splitlines()[0].strip().split("#")
    assert (caption, tokens.split(" "), float(start), float(end)) == ("a b c", ["a/X", "b/X"], 0.0, 0.0)
    assert plain_tokens("The dancer's left arm.") == "the/OTHER dancer's/OTHER left/OTHER arm/OTHER"


def test_spans_and_instants_of_one_name_where_rows_state_their_kind(tmp_path: Path) -> None:
    flags = [
        Segment(Layer("quality", kind="instant", sided="no"), Fraction(1), Fraction(1), "spike", value=0.5),
        Segment(Layer("quality", sided="no"), Fraction(0), Fraction(4), "implausible_body"),
    ]
    write_segment_file(tmp_path / "q.csv", [("a", flags)])
    assert [repr(row.segment) for row in read_segment_file(tmp_path / "q.csv")] == [repr(flag) for flag in flags]

"""Motorica++: both forms of labels, each quirk against what STREAM's own code reads."""

import json
import lzma
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from dancedata.core.errors import DataError, SourceError
from dancedata.core.segments import Segment
from dancedata.datasets.motorica import Motorica
from dancedata.datasets.motorica.labels import joined, read_labels, read_text, write_example
from dancedata.datasets.motorica.motion import write_example as write_recordings
from tests.messages import raises_message

DATA = Path(__file__).resolve().parents[1] / "golden" / "data" / "crowd" / "stream.json.xz"
NAME = "kthstreet_gPO_sFM_cAll_d02_mPO_ch01_bombom_001"
JAZZ = "kthjazz_gJZ_sFM_cAll_d02_mJZ_ch01_madeupswing_001"


@pytest.fixture(scope="module")
def stream() -> dict[str, Any]:
    data: dict[str, Any] = json.loads(lzma.decompress(DATA.read_bytes()))
    return data


@pytest.fixture(scope="module")
def published(stream: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("labels")
    for name, text in stream["files"].items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def runs(segments: Sequence[Segment], length: int, fps: int = 30) -> list[list[Any]]:
    """Runs of frames as STREAM has them: the later segment wins, a gap is empty."""
    frames: list[tuple[str, str, str]] = [("", "", "")] * length
    for segment in segments:
        start, end = (int(t * fps) for t in (segment.start, segment.end))
        label = segment.data.get("genre", ""), segment.label, segment.texts[0] if segment.texts else ""
        frames[start:end] = [label] * (min(end, length) - start)
    starts = [k for k in range(length) if k == 0 or frames[k] != frames[k - 1]]
    return [[a, b, *frames[a]] for a, b in zip(starts, [*starts[1:], length], strict=True)]


@pytest.mark.parametrize("chunk", ["chunk8", "chunk9", "chunk10", "chunk10_M", "chunk11"])
def test_chunks_as_their_code_reads_them(stream: dict[str, Any], published: Path, chunk: str) -> None:
    segments = joined({(0, False): published / "motorica" / "sliced_labels" / f"{NAME}_{chunk}_label.json"})
    wanted = stream["chunks"][f"{NAME}_{chunk}"]
    actual = runs(segments, wanted["shape"][0], wanted["current_fps"])
    # Theirs are cut at 1,000 characters, these are whole.
    actual = [[a, b, genre, label, min(len(text), 1000), text[:40]] for a, b, genre, label, text in actual]
    assert actual == wanted["per_frame_runs_start_end_genre_label_len_description"]
    assert len(segments[-1].texts if segments else ()) <= wanted["candidates"]
    if chunk == "chunk9":  # one text, and a list
        assert (segments[0].texts, segments[1].texts[:2]) == (("a gap follows",), ("one", "two"))
        # Past the end their ramp fails; here the store cuts frames and keeps the time.
        folder = published / "motorica" / "sliced_labels"
        assert joined({(0, False): folder / f"{NAME}_chunk12_label.json"})[-1].end == Fraction(200, 30)


def test_the_end_of_a_text_file_is_inclusive_and_numbers_are_in_order(stream, published):
    paths = sorted((published / "label_segment").iterdir(), key=lambda p: int(p.stem.rpartition("_")[2]))
    segments = read_labels(published).of[NAME]
    assert segments == tuple(map(read_text, paths))
    assert [s.label for s in segments] == [f"move {k}" for k in range(5)]
    assert segments[2].end - segments[2].start == Fraction(1, 30)
    whole = stream["label_segment_to_windows"]
    for window in whole["windows"]:
        first = Fraction(window["chunk"])
        moved = [
            (max(s.start - first, Fraction(0)), min(s.end - first, Fraction(5)), s.data["genre"], s.label, s.texts[0])
            for s in segments if s.end > first and s.start < first + 5
        ]  # fmt: skip
        wanted = [
            (Fraction(s["start"], 30), Fraction(s["end"], 30), s["genre"], s["label"], s["description"])
            for s in window["segments"] if s["label"]
        ]  # fmt: skip
        assert moved == wanted


def test_a_colon_in_a_description(stream: dict[str, Any], published: Path) -> None:
    segment = read_text(published / "motorica_seg" / f"{NAME}_0_label.txt")
    (wanted,) = stream["txt"].values()
    assert segment.texts == (wanted["description"],)
    assert (segment.start, segment.end) == (Fraction(wanted["start"], 30), Fraction(wanted["end"] + 1, 30))
    assert segment.layer.licence == "CC BY-NC 4.0"


def write_chunks(folder: Path, segments: list[dict[str, Any]], n: int) -> dict[tuple[int, bool], Path]:
    """Chunks of 5 s each second, as their writer cuts them."""
    chunks = {}
    for k in range(n):
        inside = [
            {**s, "start": max(s["start"] - 30 * k, 0), "end": min(s["end"] - 30 * k, 150)}
            for s in segments if s["start"] < 30 * k + 150 and s["end"] > 30 * k
        ]  # fmt: skip
        path = chunks[k, False] = folder / f"{NAME}_chunk{k}_label.json"
        path.write_text(json.dumps({"fps": 30, "length": 150, "segments": inside}))
    return chunks


MOVES = [
    {"start": 0, "end": 40, "genre": "popping", "label": "a", "description": "one"},
    {"start": 40, "end": 170, "genre": "popping", "label": "b", "descriptions": ["two", "left"]},
    {"start": 200, "end": 210, "genre": "popping", "label": "a", "description": "one"},
]


def test_chunks_are_joined_to_the_segments_of_the_recording(tmp_path: Path) -> None:
    segments = joined(write_chunks(tmp_path, MOVES, 4))
    spans = [(int(s.start * 30), int(s.end * 30), s.label, list(s.texts)) for s in segments]
    assert spans == [(0, 40, "a", ["one"]), (40, 170, "b", ["two", "left"]), (200, 210, "a", ["one"])]


def test_the_words_of_mirrored_chunks(tmp_path: Path) -> None:
    chunks = write_chunks(tmp_path, MOVES[:2], 2)
    for k in range(2):
        path = chunks[k, True] = tmp_path / f"{NAME}_chunk{k}_M_label.json"
        path.write_text(chunks[k, False].read_text().replace("left", "right"))
    assert [s.texts_mirrored for s in joined(chunks)] == [("one",), ("two", "right")]
    chunks[1, True].write_text(json.dumps({"fps": 30, "length": 150, "segments": []}))
    assert {s.texts_mirrored for s in joined(chunks)} == {(), ("one",), ("two", "right")}


def test_chunks_that_disagree_are_no_recording(published: Path, tmp_path: Path) -> None:
    folder = published / "motorica" / "sliced_labels"
    labels = read_labels(folder)
    (reject,) = labels.rejects
    assert (reject.reason, reject.clip, labels.of) == ("bad_segment", NAME, {})
    with raises_message(DataError, "label", reason="bad_segment"):
        joined({(k, False): folder / f"{NAME}_chunk{k}_label.json" for k in (8, 9)})


@pytest.mark.parametrize(
    "text",
    ["[", "{}", '{"fps": 0, "length": 1, "segments": [{"start": 0, "end": 1}]}', '{"fps": 30, "length": 1}',
     '{"fps": 30, "length": 9, "segments": [{"start": 5, "end": 1, "genre": "", "label": "", "description": ""}]}',
     '{"fps": 30, "length": 9, "segments": [{"start": 0, "end": 1, "description": [1]}]}'],
)  # fmt: skip
def test_broken_chunks(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a_chunk0_label.json"
    path.write_text(text)
    with raises_message(DataError, "label", where="a_chunk0_label.json", reason="bad_segment"):
        joined({(0, False): path})
    for lines in ("", "start: 1\nend: 2\n", "fps: 30\nstart: 5\nend: 1\n", "fps: x\nstart: 1\nend: 2"):
        (tmp_path / "a_0.txt").write_text(lines)
        with raises_message(DataError, "label", where="a_0.txt", reason="bad_segment"):
            read_text(tmp_path / "a_0.txt")


def test_the_reader_takes_labels(tmp_path: Path) -> None:
    write_recordings(tmp_path / "source", dance_s=2)
    write_example(tmp_path / "labels", JAZZ)
    write_example(tmp_path / "labels", "someone_else")
    scan = Motorica(labels=tmp_path / "labels").scan(tmp_path / "source")
    clip = next(clip for clip in scan.clips if clip.id == JAZZ)
    assert [s.label for s in clip.segments] == ["step touch", "spin", "wave", "freeze"]
    assert [(r.reason, r.clip) for r in scan.rejects if "segment" in r.reason] == [
        ("unused_segments", "someone_else")
    ]
    assert any(note.startswith("Labels: Motorica++ of 2 recordings") for note in scan.notes)
    trimmed = Motorica(labels=tmp_path / "labels", trim_s=0.5).scan(tmp_path / "source")
    moved = next(clip for clip in trimmed.clips if clip.id == JAZZ).segments
    assert moved[1].start == clip.segments[1].start - Fraction(1, 2)
    plain = Motorica().scan(tmp_path / "source")
    assert not any(clip.segments for clip in plain.clips)
    assert Motorica(labels=tmp_path / "labels").segments(clip) == clip.segments


def test_a_folder_without_labels(tmp_path: Path) -> None:
    write_recordings(tmp_path / "source", dance_s=1)
    (tmp_path / "source" / "x.md").write_text("")
    with raises_message(SourceError, "label_segment", where="source"):
        Motorica(labels=tmp_path / "source").scan(tmp_path / "source")
    with raises_message(SourceError, "label_segment", where="nowhere"):
        read_labels(tmp_path / "nowhere")

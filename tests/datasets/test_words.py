"""Words beside own data: segments.csv, segments.jsonl and texts/ of a folder."""

from fractions import Fraction
from pathlib import Path

import pytest

import dancedata
from dancedata.core.errors import SourceError, StoreError
from dancedata.datasets.folder import Folder
from tests.messages import raises_message

READER = Folder
RECIPE = {
    "recipe": 1, "name": "words", "dataset": {"folder": {"fps": 30, "unit": "m", "up": "y", "language": "en"}},
    "windows": {"length_s": 2, "stride_s": 1}, "motion": {"joints": {}}, "audio": {}, "augment": {"mirror": True},
}  # fmt: skip


def ids(source: Path) -> list[str]:
    return [clip.id for clip in Folder().scan(source).clips]


def test_words_go_from_the_source_into_the_dataset(source: Path, tmp_path: Path, cache: Path) -> None:
    first, second, *_ = ids(source)
    before = {r.file for r in Folder().scan(source).rejects}
    (source / "texts").mkdir()
    (source / "texts" / f"{first}.txt").write_text("turns left#turn/VERB left/ADJ#0.0#0.0\n")
    (source / "texts" / "nobody.txt").write_text("x#x/X#0.0#0.0\n")
    (source / "texts" / f"{second}.txt").write_text("broken\n")
    rows = f"{first},0.5,1.5,moves,left spin\nnobody,0,1,moves,\n{second},9999,10000,moves,x\n"
    (source / "segments.csv").write_text(f"clip,start,end,layer,label\n{rows}")
    scan = Folder(language="en").scan(source)
    left_out = {(r.reason, r.clip or r.file) for r in scan.rejects if r.file not in before}
    assert left_out == {
        ("unused_segments", "segments.csv"), ("unused_segments", "texts/nobody.txt"), ("bad_segment", second),
    }  # fmt: skip
    assert any("Captions: texts/" in note for note in scan.notes)
    store = dancedata.build(RECIPE, source, tmp_path / "out", jobs=1, cache=cache, progress=False).open()
    words, move = store.segments(first)
    length = store.grid.seconds(store[first].n_frames)
    assert (words.texts, words.texts_mirrored, words.end) == (("turns left",), ("turns right",), length)
    assert (move.label, move.start, move.layer.sided) == ("left spin", Fraction(1, 2), "mirrored")
    assert sum(layer["empty"] for layer in store.info["layers"]) >= 1
    words, move = store.segments(f"{first}__mirror")
    assert (words.texts, words.tokens, move.label) == (("turns right",), ("turn/VERB right/ADJ",), "right spin")


def test_changed_words_are_another_source(source: Path, tmp_path: Path, cache: Path) -> None:
    first = ids(source)[0]
    (source / "segments.jsonl").write_text(f'{{"clip": "{first}", "start": 0, "end": "end", "layer": "w"}}\n')
    build = {"jobs": 1, "cache": cache, "progress": False}
    assert dancedata.build(RECIPE, source, tmp_path / "out", **build).built
    assert not dancedata.build(RECIPE, source, tmp_path / "out", **build).built
    (source / "segments.jsonl").write_text(f'{{"clip": "{first}", "start": 0, "end": 1, "layer": "w"}}\n')
    with pytest.raises(StoreError, match="another source"):
        dancedata.build(RECIPE, source, tmp_path / "out", **build)


def test_two_files_and_partners_that_are_not_there(source: Path) -> None:
    first = ids(source)[0]
    (source / "segments.csv").write_text(f"clip,start,end,layer,other\n{first},0,1,contacts,{first}x\n")
    with raises_message(SourceError, "amass_poses", where="мой dänce/segments.csv, line 2"):
        Folder().scan(source)
    (source / "segments.jsonl").write_text("")
    with raises_message(SourceError, "segments", where="мой dänce"):
        Folder().scan(source)

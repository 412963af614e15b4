"""Segments: a summary, a file of all segments, and layers replaced by those of a file."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import dancedata
from dancedata.cli.app import app
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.registry import DATASETS
from dancedata.files.regular_file import sha256_file
from dancedata.pages.write import write_report
from dancedata.segments.command import segments
from dancedata.store import Store, verify_store
from dancedata.store.schema import SEGMENTS_FILE
from tests.messages import raises_message

RECIPE = {
    "recipe": 1, "name": "words", "dataset": {"folder": {"fps": 30, "unit": "m", "up": "y", "language": "en"}},
    "windows": {"length_s": 2, "stride_s": 1}, "motion": {"joints": {}}, "audio": {},
    "augment": {"mirror": True, "tempo": {"speeds": [1.25]}},
}  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Path:
    folder = tmp_path_factory.mktemp("segments")
    source = folder / "source"
    DATASETS.get("folder")().make_example(source)
    (source / "segments.csv").write_text(
        "clip,start,end,layer,label,text\nown,0.5,1.5,moves,left spin,\nown,0,end,description,,to the left\n"
        "own,0.501,0.502,moves,left spin,\n"
    )
    return dancedata.build(RECIPE, source, folder / "out", jobs=1, cache=cache, progress=False).path


@pytest.fixture
def built(whole: Path, tmp_path: Path) -> Store:
    return dancedata.open(shutil.copytree(whole, tmp_path / "out"))


def hashes(folder: Path) -> dict[str, str]:
    return {path.name: sha256_file(path) for path in folder.iterdir()}


def empty(store: Store) -> int:
    """How many segments cover no frame."""
    return sum(layer["empty"] for layer in store.info["layers"])


def described(store: Store) -> dict[str, list[str]]:
    return {clip.id: [repr(s) for s in store.segments(clip.id)] for clip in store}


@pytest.mark.parametrize("name", ["all.csv", "all.jsonl"])
def test_all_segments_as_a_file_and_back(built: Store, tmp_path: Path, name: str) -> None:
    before = hashes(built.path)
    result = segments(built.path, to=tmp_path / name)
    assert {layer["name"]: layer["segments"] for layer in result.layers}["moves"] == 1
    assert "written to" in str(result)
    with raises_message(UsageError, "exists"):
        segments(built.path, to=tmp_path / name)
    segments(built.path, set_file=tmp_path / name)
    after = hashes(built.path)
    assert verify_store(built.path) == []
    assert described(dancedata.open(built.path)) == described(built)
    assert empty(dancedata.open(built.path)) == empty(built) > 0
    assert {name for name in before if before[name] != after[name]} <= {"dataset.json"}
    (tmp_path / "none.jsonl").write_text("")
    segments(built.path, set_file=tmp_path / "none.jsonl")
    assert hashes(built.path) == after, "a file without rows replaces no layer"


def test_a_file_replaces_its_layers_and_goes_with_copies(built: Store, tmp_path: Path) -> None:
    before, old = hashes(built.path), described(built)
    shard = next(path for path in built.path.iterdir() if path.name.startswith("train-0"))
    inode = shard.stat().st_ino
    more = tmp_path / "more.jsonl"
    rows = [
        {"clip": "own", "start": 0, "end": 5, "layer": "description", "language": "en", "text": "to the right, fast"},
        {"clip": "amass_poses", "start": 1, "layer": "mark"},
    ]
    more.write_text("".join(json.dumps(row) + "\n" for row in rows))
    segments(built.path, set_file=more)
    assert verify_store(built.path) == []
    store = dancedata.open(built.path)
    after = hashes(built.path)
    assert {name for name in before if before[name] != after[name]} == {"dataset.json", SEGMENTS_FILE}
    assert shard.stat().st_ino == inode
    (words,) = store.segments("own", "description")
    (mirrored,) = store.segments("own__mirror", "description")
    (faster,) = store.segments("own__tempo", "description")
    assert (words.texts, words.end) == (("to the right, fast",), 5)
    assert mirrored.texts == ("to the left, fast",)
    assert (faster.texts, faster.end) == (words.texts, 4)
    assert [repr(s) for s in store.segments("own", "moves")] == [s for s in old["own"] if "name='moves'" in s]
    assert store.segments("amass_poses", "mark")[0].layer.kind == "instant"
    assert len(store.segments("amass_poses__mirror", "mark")) == 1


def test_a_file_that_does_not_fit_changes_nothing(built: Store, tmp_path: Path) -> None:
    before = hashes(built.path)
    (tmp_path / "more.csv").write_text("clip,start,layer\nnobody,1,mark\n")
    with raises_message(SourceError, "correct", where="more.csv, line 2"):
        segments(built.path, set_file=tmp_path / "more.csv")
    with raises_message(UsageError, "description", where="out"):
        segments(built.path, layer="move")
    with raises_message(UsageError, "jsonl", where="all.txt"):
        segments(built.path, to=tmp_path / "all.txt")
    assert hashes(built.path) == before


def test_the_command(built: Store, tmp_path: Path) -> None:
    out = tmp_path / "moves.csv"
    result = CliRunner().invoke(app, ["export", str(built.path), "--to", "segments", "--out", str(out), "--json"])
    assert result.exit_code == 0, result.output
    (layer,) = [layer for layer in json.loads(result.output)["result"]["layers"] if layer["name"] == "moves"]
    assert (layer["name"], layer["clips"], layer["sided"]) == ("moves", 1, "mirrored")
    assert any(line.startswith("own,1/2,3/2,moves,span,") for line in out.read_text().splitlines())


def test_numbers_of_layers(built: Store, tmp_path: Path) -> None:
    moves, words = sorted(built.layer_numbers(), key=lambda layer: -ord(layer.name[0]))
    frames = {clip.id: clip.n_frames for clip in built.clips() if not clip.source}
    assert (moves.segments, moves.clips, moves.median_s, moves.labels) == (1, 1, 1.0, {"left spin": 1})
    assert moves.coverage == pytest.approx(30 / sum(frames.values()))
    assert (words.texts, words.words) == (1, 3)
    assert words.coverage == pytest.approx(frames["own"] / sum(frames.values()))
    document = write_report(built.path, to=tmp_path / "page.html", clips="none").to_json()["report"]
    assert [layer["name"] for layer in document["segments"]] == [layer.name for layer in built.layers]
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Layers of segments" in text
    assert "left spin 1" in text
    # Segments that overlap cover a frame once.
    rows = [("own", 0, 2), ("own", 1, 3), ("own", 1, 2), ("smpl", 0, 1)]
    lines = "".join(f"{clip},{start},{end},moves\n" for clip, start, end in rows)
    (tmp_path / "more.csv").write_text("clip,start,end,layer\n" + lines)
    segments(built.path, set_file=tmp_path / "more.csv")
    (moves,) = (layer for layer in dancedata.open(built.path).layer_numbers() if layer.segments == 4)
    assert moves.coverage * sum(frames.values()) == pytest.approx(120)


def test_what_mirrored_copies_go_without_is_noted(built: Store, tmp_path: Path) -> None:
    (tmp_path / "fr.csv").write_text("clip,start,end,layer,language,text\nown,0,1,description,fr,à gauche\n")
    result = segments(built.path, set_file=tmp_path / "fr.csv")
    assert result.notes == ("mirrored copies go without 1 segment of description: no lexicon of the language",)
    assert "note: mirrored copies" in str(result)
    store = dancedata.open(built.path)
    assert sorted(s.layer.language for s in store.segments("own", "description")) == ["en", "fr"]
    assert [s.layer.language for s in store.segments("own__mirror", "description")] == ["en"]


def test_units_and_pairs_of_labels_without_a_row_are_kept(built: Store, tmp_path: Path) -> None:
    rows = [
        {"clip": "own", "start": 0, "end": 1, "layer": "kicks", "label": "kick_l", "label_mirrored": "kick_r"},
        {"clip": "own", "start": 1, "end": 2, "layer": "kicks", "label": "jump", "value": 0.4, "unit": "m"},
        {"clip": "own", "start": 2, "end": 3, "layer": "kicks", "label": "a_l", "label_mirrored": "a_r"},
    ]
    for name, n in (("all", 3), ("fewer", 1)):
        text = "".join(json.dumps(row) + "\n" for row in rows[:n])
        (tmp_path / f"{name}.jsonl").write_text(text)
        segments(built.path, set_file=tmp_path / f"{name}.jsonl")
    layers = {layer for layer in dancedata.open(built.path).layers if layer.name == "kicks"}
    assert {layer.units for layer in layers} == {(("jump", "m"),)}
    assert {layer.mirror for layer in layers} == {(("a_l", "a_r"), ("kick_l", "kick_r"))}
    before = hashes(built.path)
    segments(built.path, to=tmp_path / "back.csv")
    segments(built.path, set_file=tmp_path / "back.csv")
    assert hashes(built.path) == before

"""Missing requirements of a dataset are reported together, before anything is written."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from shutil import copytree, ignore_patterns

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DanceDataError, RecipeError, StoreError, UsageError
from dancedata.core.registry import DATASETS
from dancedata.store import write_store
from dancedata.store.schema import LOCAL_FILE
from dancedata.testing.stores import write_random_store
from tests.messages import raises_message


def refusal(store: Path, to: str, out: Path, **options) -> str:
    with raises_message(DanceDataError, "exported") as caught:
        dancedata.export(store, to, out, progress=False, **options)
    assert not out.exists()
    assert not [p.name for p in out.parent.iterdir() if p.name.startswith(".dancedata")]
    return str(caught.value)


@pytest.mark.parametrize(
    ("to", "wanted"),
    [
        ("edge", ["60 frames per second, not 30", "fix: fps: 30", "no field edge151", "fix: motion: {edge151: {}}",
                  "librosa35 has 60 rows per second, not 30", "fix: audio: {librosa35: {fps: 30}}", "--music DIR"]),
        ("popdg", ["no field edge151", "--music DIR"]),
        ("lodge", ["60 frames per second", "no field lodge139", "as in the recipe aist++-lodge or finedance",
                   "without one of the 16 genres", "name clips 001 to 211"]),
        ("finedance", ["no field finedance319", "name clips 001 to 211"]),
        ("bailando", ["no field bailando438", "--music DIR"]),
    ],
)  # fmt: skip
def test_all_problems_are_reported_at_once(built, tmp_path: Path, to: str, wanted: list[str]) -> None:
    if to == "lodge":
        pytest.importorskip("torch")  # its absence would be in the message
    store = copytree(built("sixty").path, tmp_path / "store", ignore=ignore_patterns(LOCAL_FILE))
    text = refusal(store, to, tmp_path / "out")
    assert f"the dataset cannot be exported as {to}; nothing was written:" in text
    for words in wanted:
        assert words in text, words


SIXTY = {"audio": {"librosa35": {}}, "motion": {"fact219": {}}}


@pytest.mark.parametrize(
    ("name", "keys", "to", "options", "words"),
    [
        # A recipe at 30 gives motion at 60 next to music at 30: the trap of FACT and Bailando.
        ("sixty", {**SIXTY, "fps": 30}, "fact", {},
         ["librosa35 has 30 rows per second, not 60\n  fix: audio: {librosa35: {fps: 60}}"]),
        ("edge-exact", {"transforms": [{"slices": {"length_s": 4}}], "windows": {"length_s": 4, "stride_s": 0.5}},
         "edge", {}, ["slices of 120 frames", "not of 150 every 15"]),
        ("edge", {}, "edge", {"feature": "jukebox"}, ["no field jukebox"]),
        ("sixty", {}, "fact", {"feature": "fact219"},
         ["fact219 is a field of the kind motion, not audio", "fact219 has 219 columns, not 35"]),
        ("edge", {"dataset": {"aist++": {"split": "all"}}}, "edge", {},
         ["no clips in train and test (its splits: all)"]),
        ("edge", {}, "npz", {"fields": ["edge15"]}, ["no field 'edge15'"]),
        ("sixty", {**SIXTY, "augment": {"mirror": True}}, "fact", {},
         ["names that the loader would read wrongly", "__mirror"]),
    ],
)  # fmt: skip
def test_what_a_target_cannot_take_is_named(built, tmp_path, name, keys, to, options, words):
    made = built(name, **keys)
    text = refusal(made.path, to, tmp_path / "out", source=made.source, **options)
    assert [part for part in words if part not in text] == []
    assert keys.get("fps") != 30 or text.count("fix:") == 1


def test_missing_music(built, tmp_path: Path) -> None:
    made = built("edge")
    (tmp_path / "empty").mkdir()
    text = refusal(made.path, "edge", tmp_path / "out", source=tmp_path / "empty")
    assert f"no music below {tmp_path}/empty for m" in text
    assert not list((tmp_path / "empty").iterdir())
    (tmp_path / "file").write_text("")
    for to, source in (("edge", "none"), ("npz", "file")):
        with raises_message(DanceDataError, "the folder of the music does not exist"):
            dancedata.export(made.path, to, tmp_path / "out", source=tmp_path / source, progress=False)


def test_music_by_its_name_alone(built, tmp_path: Path) -> None:
    made = built("edge")
    (tmp_path / "music" / "deep").mkdir(parents=True)
    for path in (made.source / "wavs").iterdir():
        (tmp_path / "music" / "deep" / path.name).symlink_to(path)
    done = dancedata.export(made.path, "edge", tmp_path / "out", source=tmp_path / "music", progress=False)
    assert list((done.path / "train" / "wavs_sliced").iterdir())


def test_ids_that_are_not_file_names(tmp_path: Path) -> None:
    made = write_random_store(tmp_path / "store", clips={"train": 2, "test": 1})
    (tmp_path / "bent").mkdir()
    write_store(tmp_path / "bent", made.header, [replace(made.clips[0], id="../../up")])
    assert "cannot be names of files: '../../up'" in refusal(tmp_path / "bent", "npz", tmp_path / "out")


def test_patterns_in_the_folders_name(built, tmp_path: Path) -> None:
    made = built("edge")
    text = refusal(made.path, "edge", tmp_path / "edge[1]", source=made.source)
    assert "lists folders by patterns" in text


@pytest.mark.parametrize(
    ("to", "options", "error", "message"),
    [
        ("egde", {}, UsageError, r"unknown export 'egde'. Did you mean 'edge'"),
        ("edge", {"scaler": "all"}, RecipeError, r"export\.edge\.scaler: unknown key"),
        ("lodge", {"scaler": "both"}, RecipeError, r"export\.lodge\.scaler"),
    ],
)
def test_unknown_targets_and_parameters(built, tmp_path, to, options, error, message):
    with raises_message(error, message):
        dancedata.export(built("edge").path, to, tmp_path / "out", **options)
    with raises_message(StoreError, "there is no finished dataset"):
        dancedata.export(tmp_path, "npz", tmp_path / "out")


def test_an_export_is_not_written_into_its_input(built) -> None:
    made = built("edge")
    for place in (made.path, made.source):
        with raises_message(UsageError, "export", where="out"):
            dancedata.export(made.path, "edge", place / "out", source=made.source, progress=False)
        assert not (place / "out").exists()


@pytest.mark.parametrize("name", ["edge", "finedance"])
def test_the_source_is_known_without_being_named(built, tmp_path: Path, name: str) -> None:
    """By its motion files: an export among them would be read as a part of the source."""
    made = built(name)
    (motions,) = (made.source / folder for folder in ("motions", "motion") if (made.source / folder).is_dir())
    (tmp_path / "link").symlink_to(made.source, target_is_directory=True)
    before = sorted(made.source.rglob("*"))
    for out in (made.source / "out", made.source / "deep" / "out", motions / "out", tmp_path / "link" / "out"):
        with raises_message(UsageError, "export", where="out"):
            dancedata.export(made.path, "npz", out, progress=False)
    assert sorted(made.source.rglob("*")) == before
    # Neither a folder next to it nor one with other files of the clips' names is a source.
    (tmp_path / "motions").mkdir()
    for path in motions.iterdir():
        (tmp_path / "motions" / path.name).write_bytes(b"another")
    assert dancedata.export(made.path, "npz", tmp_path / "motions" / "out", progress=False).path.is_dir()


def test_the_source_of_a_manifest(tmp_path: Path) -> None:
    """Its motion may lie in any folder below it."""
    source = tmp_path / "source"
    DATASETS.get("folder")().make_example(source)
    (source / "motions").rename(source / "captured")
    manifest = source / "manifest.csv"
    manifest.write_text(manifest.read_text().replace("motions/", "captured/"))
    recipe = {
        "recipe": 1, "name": "own", "dataset": {"folder": {"music": "optional"}}, "motion": {"edge151": {}},
        "windows": {"length_s": 2, "stride_s": 1},
    }  # fmt: skip
    dancedata.build(recipe, source, tmp_path / "store", jobs=1, cache=tmp_path / "cache", progress=False)
    with raises_message(UsageError, "export", where="source/out"):
        dancedata.export(tmp_path / "store", "npz", source / "out", progress=False)
    dancedata.export(tmp_path / "store", "npz", tmp_path / "out", progress=False)


def test_the_working_folder_is_not_replaced(built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with raises_message(UsageError, "working"):
        dancedata.export(built("edge").path, "npz", ".", progress=False)


def test_clips_shorter_than_a_window(tmp_path: Path) -> None:
    store = write_random_store(tmp_path / "short").path  # clips of 40 to 140 frames
    text = refusal(store, "edge", tmp_path / "out", sound="silence")
    assert "train has no window of five seconds\n  fix: longer clips" in text
    assert "test has no window of five seconds" in text


def test_npz_holds_the_dataset(export: Callable, built) -> None:
    import json

    for name in ("edge", "edge-exact"):
        out, store = export(name, "npz", name, source=built(name).source, link=True).path, built(name).store
        index = json.loads((out / "index.json").read_text())
        assert set(index["clips"]) == {clip.id for clip in store}
        for clip in store:
            held = np.load(out / index["clips"][clip.id]["file"])
            assert index["clips"][clip.id]["music_file"] == f"music/{clip.music}.wav"
            song = (built(name).source / "wavs" / f"{clip.music}.wav").read_bytes()
            assert (out / index["clips"][clip.id]["music_file"]).read_bytes() == song
            for field in store.fields:
                np.testing.assert_array_equal(held[field], clip.read(field))
        for split in store.splits:
            assert index["windows"][split] == [[w.clip, w.start, w.length] for w in store.windows(split)]
        window = store.windows("train")[0]
        start, rows = window.start, np.load(out / f"clips/{window.clip}.npz")["edge151"]
        np.testing.assert_array_equal(rows[start : start + 150], store.read(window, "edge151"))
        assert index["fields"]["edge151"]["scaler"] == store.scaler("edge151").state_dict()

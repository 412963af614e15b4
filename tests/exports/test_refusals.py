"""Missing requirements of a dataset are reported together, before anything is written."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DanceDataError, RecipeError, SourceError, StoreError, UsageError
from dancedata.core.registry import DATASETS
from dancedata.exports.base.job import EXPORTS
from dancedata.store import StoredClip, write_store
from dancedata.store.schema import StoreHeader
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
                  "librosa35 has 60 rows per second, not 30", "fix: audio: {librosa35: {fps: 30}}", "--source DIR"]),
        ("popdg", ["no field edge151", "--source DIR"]),
        ("lodge", ["60 frames per second", "no field lodge139", "as in the recipe aist++-lodge or finedance",
                   "without one of the 16 genres", "name clips 001 to 211"]),
        ("finedance", ["no field finedance319", "name clips 001 to 211"]),
        ("bailando", ["no field bailando438", "--source DIR"]),
    ],
)  # fmt: skip
def test_all_problems_are_reported_at_once(built, tmp_path: Path, to: str, wanted: list[str]) -> None:
    if to == "lodge":
        pytest.importorskip("torch")  # its absence would be in the message
    text = refusal(built("sixty").path, to, tmp_path / "out")
    assert f"the dataset cannot be exported as {to}; nothing was written:" in text
    for words in wanted:
        assert words in text, words


def test_thirty_per_second_next_to_sixty(built, tmp_path: Path) -> None:
    """A recipe at 30 gives motion at 60 next to music at 30: the trap of FACT and Bailando."""
    made = built("sixty", fps=30, audio={"librosa35": {}}, motion={"fact219": {}, "bailando72": {}})
    text = refusal(made.path, "fact", tmp_path / "out")
    assert text.count("fix:") == 1
    assert "librosa35 has 30 rows per second, not 60\n  fix: audio: {librosa35: {fps: 60}}" in text


def test_window_scope(built, tmp_path: Path) -> None:
    text = refusal(built("edge-exact").path, "fact", tmp_path / "out")
    assert "the dataset has window scope, without whole clips\n  fix: scope: track" in text
    made = built("edge-exact", windows={"length_s": 4, "stride_s": 0.5, "order": "name"})
    text = refusal(made.path, "edge", tmp_path / "out", source=made.source)
    assert "windows of 120 frames every 15, not 150 every 15" in text


def test_widths_and_features(built, tmp_path: Path) -> None:
    made = built("edge")
    assert "no field jukebox" in refusal(made.path, "edge", tmp_path / "out", source=made.source, feature="jukebox")
    text = refusal(built("sixty").path, "fact", tmp_path / "out", feature="fact219")
    assert "fact219 is a field of the kind motion, not audio" in text
    assert "fact219 has 219 columns, not 35" in text


def test_missing_splits(built, tmp_path: Path) -> None:
    made = built("edge", dataset={"aist++": {"split": "all"}})
    text = refusal(made.path, "edge", tmp_path / "out", source=made.source)
    assert "no clips in train and test (its splits: all)" in text


def test_missing_music(built, tmp_path: Path) -> None:
    made = built("edge")
    (tmp_path / "empty").mkdir()
    text = refusal(made.path, "edge", tmp_path / "out", source=tmp_path / "empty")
    assert f"no music below {tmp_path}/empty for m" in text
    assert not list((tmp_path / "empty").iterdir())
    refused = refusal(made.path, "edge", tmp_path / "out", source=tmp_path / "none")
    assert "the folder of the music does not exist" in refused


def test_music_by_its_name_alone(built, tmp_path: Path) -> None:
    made = built("edge")
    (tmp_path / "music" / "deep").mkdir(parents=True)
    for path in (made.source / "wavs").iterdir():
        (tmp_path / "music" / "deep" / path.name).symlink_to(path)
    done = dancedata.export(made.path, "edge", tmp_path / "out", source=tmp_path / "music", progress=False)
    assert list((done.path / "train" / "wavs_sliced").iterdir())


def test_names_that_would_be_read_wrongly(built, tmp_path: Path) -> None:
    made = built("sixty", augment={"mirror": True}, audio={"librosa35": {}}, motion={"fact219": {}})
    text = refusal(made.path, "fact", tmp_path / "out")
    assert "names that the loader would read wrongly" in text
    assert "__mirror" in text


def test_ids_that_are_not_file_names(tmp_path: Path) -> None:
    made = write_random_store(tmp_path / "store", clips={"train": 2, "test": 1})
    first = made.clips[0]
    values = {name: getattr(first, name) for name in StoredClip.__dataclass_fields__}
    bent = StoredClip(**{**values, "id": "../../up"})
    header = StoreHeader(**{name: getattr(made.header, name) for name in StoreHeader.__dataclass_fields__})
    (tmp_path / "bent").mkdir()
    write_store(tmp_path / "bent", header, [bent])
    assert "cannot be names of files: '../../up'" in refusal(tmp_path / "bent", "npz", tmp_path / "out")


def test_patterns_in_the_folders_name(built, tmp_path: Path) -> None:
    made = built("edge")
    text = refusal(made.path, "edge", tmp_path / "edge[1]", source=made.source)
    assert "lists folders by patterns" in text


def test_unknown_targets_and_parameters(built, tmp_path: Path) -> None:
    store = built("edge").path
    with pytest.raises(UsageError, match=r"unknown export 'egde'. Did you mean 'edge'"):
        dancedata.export(store, "egde", tmp_path / "out")
    with pytest.raises(RecipeError, match=r"export\.edge\.scaler: unknown key"):
        dancedata.export(store, "edge", tmp_path / "out", scaler="all")
    with pytest.raises(RecipeError, match=r"export\.lodge\.scaler"):
        dancedata.export(store, "lodge", tmp_path / "out", scaler="both")
    with pytest.raises(StoreError, match="there is no finished dataset"):
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
        "recipe": 1,
        "name": "own",
        "dataset": {"folder": {"music": "optional"}},
        "windows": {"length_s": 2, "stride_s": 1},
    }
    dancedata.build({**recipe, "motion": {"edge151": {}}}, source, tmp_path / "store", progress=False)
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


def test_npz_names_missing_fields(built, tmp_path: Path) -> None:
    assert "no field 'edge15'" in refusal(built("edge").path, "npz", tmp_path / "out", fields=["edge15"])


def test_errors_of_the_source_are_their_own(built, tmp_path: Path) -> None:
    made = built("edge")
    (tmp_path / "file").write_text("")
    with pytest.raises((SourceError, StoreError), match="the folder of the music does not exist"):
        dancedata.export(made.path, "npz", tmp_path / "out", source=tmp_path / "file", progress=False)


@pytest.mark.parametrize("to", EXPORTS.names())
def test_a_target_lists_its_options(to: str) -> None:
    cls = EXPORTS.get(to)
    assert isinstance(cls.recipe, dict)
    assert not any(folder in ("", ".") for folder in cls.listed_folders)


def test_npz_holds_the_dataset(export: Callable, built) -> None:
    import json

    for name in ("edge", "edge-exact"):
        out, store = export(name, "npz", name, link=True).path, built(name).store
        index = json.loads((out / "index.json").read_text())
        assert set(index["clips"]) == {clip.id for clip in store.clips}
        for clip in store.clips:
            held = np.load(out / index["clips"][clip.id]["file"])
            assert index["clips"][clip.id]["music_file"] == f"music/{clip.music}.wav"
            song = (built(name).source / "wavs" / f"{clip.music}.wav").read_bytes()
            assert (out / index["clips"][clip.id]["music_file"]).read_bytes() == song
            for field in store.fields:
                if store.scope == "track":
                    np.testing.assert_array_equal(held[field], clip.read(field))
        for split in store.splits:
            assert index["windows"][split] == [[w.clip, w.start, w.length] for w in store.windows(split)]
        window = store.windows("train")[0]
        start, rows = window.start, np.load(out / f"clips/{window.clip}.npz")["edge151"]
        piece = rows[start : start + 150] if store.scope == "track" else rows[start // 15]
        np.testing.assert_array_equal(piece, store.read(window, "edge151"))
        assert index["fields"]["edge151"]["scaler"] == store.normalizer("edge151").state_dict()

"""verify_store finds what can be wrong with a dataset."""

import dataclasses
import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from dancedata.core.hashing import json_sha256
from dancedata.files.regular_file import sha256_file
from dancedata.store import open_store, verify_store, write_store
from dancedata.testing.stores import random_fields, write_random_store

TRAIN = "train-00000-of-00001.h5"


def seal(folder: Path) -> None:
    """Make sizes and hashes right again after a change, so that only deeper defects are left to find."""
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    for entry, name in [(e, e["file"]) for e in info["shards"]] + [(e, n) for n, e in info["files"].items()]:
        if not (folder / name).is_file():
            continue
        entry.update(size=(folder / name).stat().st_size, sha256=sha256_file(folder / name))
    info.pop("self_sha256", None)
    path.write_text(json.dumps({**info, "self_sha256": json_sha256(info)}))


def change_json(folder: Path, change: Callable[[dict[str, Any]], None], *, hide: bool = True) -> None:
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    change(info)
    path.write_text(json.dumps(info))
    if hide:
        seal(folder)


def edit(folder: Path, dataset: str, index: Any, value: Any, shard: str = TRAIN) -> None:
    """Change values of a shard and hide it from the hashes."""
    with h5py.File(folder / shard, "r+", locking=False) as file:
        file[dataset][index] = value
    seal(folder)


def only_error(folder: Path) -> str:
    [problem] = [p for p in verify_store(folder) if p.severity == "error"]
    return str(problem)


def test_sound_dataset_has_no_problems(make_store: Any, scope: str) -> None:
    assert verify_store(make_store(scope=scope, shard_bytes=9000).path) == []
    assert verify_store(make_store(scope=scope, clips={"test": 1}).path) == []


def test_flipped_bit_anywhere(make_store: Any) -> None:
    made = make_store()
    for path in sorted(made.path.iterdir()):
        data = bytearray(path.read_bytes())
        for place in {0, len(data) // 2, len(data) - 1} if data else set():
            changed = bytearray(data)
            changed[place] ^= 1
            path.write_bytes(changed)
            problems = verify_store(made.path)
            assert problems, (path, place)
            assert path.name in problems[0].where, (path, place)
        path.write_bytes(data)
    assert verify_store(made.path) == []


@pytest.mark.parametrize("keep", [0, 1000, -1])
def test_truncated_shard_is_not_parsed(make_store: Any, keep: int, monkeypatch: Any) -> None:
    made = make_store()
    path = made.path / TRAIN
    path.write_bytes(path.read_bytes()[:keep])

    def parse(path: Path, *others: Any) -> Any:
        assert path.name != TRAIN
        return [], ()

    monkeypatch.setattr("dancedata.store.verify.verify_shard", parse)
    assert "bytes, in dataset.json" in only_error(made.path)


def test_changed_shard_of_the_same_size_is_not_parsed(make_store: Any, monkeypatch: Any) -> None:
    made = make_store()
    path = made.path / TRAIN
    data = path.read_bytes()
    path.write_bytes(bytes(8) + data[8:])

    def parse(path: Path, *others: Any) -> Any:
        assert path.name != TRAIN
        return [], ()

    monkeypatch.setattr("dancedata.store.verify.verify_shard", parse)
    assert "bytes have changed" in only_error(made.path)


def test_missing_files(make_store: Any) -> None:
    for name in (TRAIN, "stats.json", "rejects.jsonl", "quality.jsonl"):
        made = make_store()
        (made.path / name).unlink()
        assert name in only_error(made.path)
        assert "missing" in only_error(made.path)
    made = make_store()
    (made.path / "dataset.json").unlink()
    assert "no finished dataset" in only_error(made.path)
    assert "no such folder" in only_error(made.path / "nowhere")


def test_changed_card_is_a_note(make_store: Any) -> None:
    made = make_store()
    (made.path / "README.md").write_text("my own words")
    [problem] = verify_store(made.path)
    assert problem.severity == "note"
    assert problem.where.endswith("README.md")
    assert problem.to_json() == {"severity": "note", "where": problem.where, "message": problem.message}


JSON_CASES: list[tuple[str, Callable[[dict[str, Any]], Any], str]] = [
    ("format", lambda d: d.update(format=7), "another format version"),
    ("no fields", lambda d: d.pop("fields"), "KeyError: 'fields'"),
    ("fps", lambda d: d.update(fps="0"), "dataset.json is incomplete"),
    ("scope", lambda d: d.update(scope="song"), "'song' is not one of"),
    ("length", lambda d: d["windows"].update(length="30"), "not a whole number"),
    ("shard path", lambda d: d["shards"][0].update(file="../x-00000-of-00001.h5"), "not the name of a shard"),
    ("clips of split", lambda d: d["counts"]["train"].update(clips=5), "counts: train has 6 clips, not 5"),
    ("songs of split", lambda d: d["counts"]["val"].update(songs=9), "counts: val has 1 songs, not 9"),
    ("hours", lambda d: d["counts"]["test"].update(hours=0.5), "hours, not 0.5"),
    ("missing count", lambda d: d["counts"].pop("val"), "counts are not those of the splits"),
    ("side file", lambda d: d["files"].pop("stats.json"), "does not list stats.json"),
    ("width", lambda d: d["fields"][0].update(name="other"), "/motion/other is missing"),
    ("windows of shard", lambda d: d["shards"][0].update(windows=3), "not 3 rows"),
    ("rate", lambda d: d["fields"][0].update(rate="60"), "/windows/rows/pose"),
    ("dtype", lambda d: d["fields"][0].update(dtype="float16"), "is of type float32, not"),
]


@pytest.mark.parametrize(("change", "message"), [c[1:] for c in JSON_CASES], ids=[c[0] for c in JSON_CASES])
def test_wrong_dataset_json(make_store: Any, change: Any, message: str) -> None:
    made = make_store()
    change_json(made.path, change, hide=not message.startswith("KeyError"))
    assert any(message in str(p) for p in verify_store(made.path)), verify_store(made.path)


def test_changed_dataset_json(make_store: Any) -> None:
    made = make_store()
    change_json(made.path, lambda d: d.update(licence="MIT"), hide=False)
    assert "self_sha256" in only_error(made.path)


@pytest.mark.parametrize("field", ["motion/pose", "motion/fast", "audio/music", "audio/layer"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite(make_store: Any, field: str, value: float) -> None:
    made = make_store()
    edit(made.path, field, (41, 2), value)
    message = only_error(made.path)
    assert field in message
    assert "1 values are not finite" in message
    assert "row 41" in message


def test_clip_of_a_bad_value_is_named(make_store: Any) -> None:
    made = make_store()
    edit(made.path, "motion/pose", (made.clips[0].n_frames, 0), np.nan)
    assert "(clip train_c01)" in only_error(made.path)


TABLE_CASES: list[tuple[str, int, int, str]] = [
    ("windows/clip", 0, 99, "clips that do not exist"),
    ("windows/start", 0, -1, "outside their clip"),
    ("windows/start", 0, 10**6, "outside their clip"),
    ("windows/length", 1, 31, "of another length"),
    ("windows/index", 2, 7, "/windows/index"),
    ("windows/rows/pose", 0, 1, "/windows/rows/pose"),
    ("windows/rows/fast", 0, -5, "/windows/rows/fast"),
    ("windows/rows/music", 3, 10**7, "/windows/rows/music"),
    ("clips/n_frames", 0, 0, "not a whole number >= 1"),
    ("clips/n_flags", 0, -1, "/clips/n_flags of clip"),
    ("clips/motion/pose/start", 1, 0, "do not follow one another"),
    ("clips/motion/fast/length", 0, 10**7, "do not follow one another"),
    ("clips/audio/music/length", 0, 10**7, "spans outside"),
    ("clips/audio/layer/offset", 0, -2, "spans outside"),
]


@pytest.mark.parametrize(("dataset", "index", "value", "message"), TABLE_CASES)
def test_rows_and_windows_out_of_bounds(make_store: Any, dataset: str, index: int, value: int, message: str) -> None:
    made = make_store()
    edit(made.path, dataset, index, value)
    assert any(message in str(p) for p in verify_store(made.path)), verify_store(made.path)


@pytest.mark.parametrize("field", ["pose", "music"])
@pytest.mark.parametrize("value", [-1, 10**7])
def test_rows_out_of_bounds_in_window_scope(make_store: Any, field: str, value: int) -> None:
    made = make_store(scope="window")
    edit(made.path, f"windows/rows/{field}", 1, value)
    assert f"/windows/rows/{field}" in only_error(made.path)


def replace(folder: Path, dataset: str, make: Callable[[Any, Any], None]) -> None:
    with h5py.File(folder / TRAIN, "r+", locking=False) as file:
        old = file[dataset][...]
        del file[dataset]
        make(file, old)
    seal(folder)


def test_other_layout(make_store: Any) -> None:
    made = make_store()
    replace(made.path, "motion/pose", lambda f, old: f.create_dataset("motion/pose", data=old, compression="gzip"))
    assert "/motion/pose is not contiguous" in only_error(made.path)
    made = make_store()
    replace(made.path, "motion/pose", lambda f, old: f.create_dataset("motion/pose", data=old.astype(">f4")))
    assert any("/motion/pose is of type >f4" in str(p) for p in verify_store(made.path))
    made = make_store()
    replace(made.path, "windows/rows/music", lambda f, old: None)
    assert "/windows/rows/music is missing" in only_error(made.path)
    made = make_store()
    replace(made.path, "clips/id", lambda f, old: f.create_dataset("clips/id", data=np.arange(len(old))))
    assert any("not fixed-length text" in str(p) for p in verify_store(made.path))
    made = make_store()
    with h5py.File(made.path / TRAIN, "r+", locking=False) as file:
        file.attrs["format"] = 2
    seal(made.path)
    assert "attribute format is 2" in only_error(made.path)


def test_shard_that_is_not_hdf5(make_store: Any) -> None:
    made = make_store()
    (made.path / TRAIN).write_bytes(b"not HDF5")
    seal(made.path)
    assert "cannot be read" in only_error(made.path)


def test_clip_in_two_splits(make_store: Any) -> None:
    made = make_store()
    edit(made.path, "clips/id", 0, b"val_c00")
    message = "clip val_c00 occurs 2 times, in train, val"
    assert any(message in str(p) for p in verify_store(made.path))


def test_songs_that_splits_share(make_store: Any, tmp_path: Path) -> None:
    made = make_store()

    def build(name: str, **music: str) -> list[Any]:
        clips = [dataclasses.replace(c, music=music.get(c.split, c.music)) for c in made.clips]
        (tmp_path / name).mkdir()
        write_store(tmp_path / name, made.header, clips)
        return verify_store(tmp_path / name)

    [problem] = build("a", train="mBR0", test="mBR0")
    assert problem.severity == "error"
    assert "train and test share songs: mBR0" in problem.message
    [problem] = build("b", train="mBR0", val="mBR0")
    assert problem.severity == "error"
    assert "train and val" in problem.message
    [problem] = build("c", val="mPO1", test="mPO1")
    assert problem.severity == "note"
    assert "val and test share songs: mPO1" in problem.message
    assert build("d", train="", val="", test="") == []


def test_copy_of_a_clip_of_another_split(make_store: Any, tmp_path: Path) -> None:
    made = make_store()
    copy = dataclasses.replace(made.clips[0], id="test_c00__mirror", source="test_c00")
    write_store_to = tmp_path / "out"
    write_store_to.mkdir()
    write_store(write_store_to, made.header, [copy, *made.clips[1:]])
    assert "is a copy of test_c00 of test" in only_error(write_store_to)


def test_files_that_belong_to_nothing(make_store: Any) -> None:
    made = make_store()
    (made.path / "train-00000-of-00009.h5").write_bytes(b"")
    (made.path / "my notes.txt").write_text("left alone")
    [problem] = verify_store(made.path)
    assert problem.severity == "note"
    assert problem.where.endswith("train-00000-of-00009.h5")


def test_memory_does_not_grow_with_the_dataset(tmp_path: Path) -> None:
    fields = random_fields({"pose": 400}, {})
    write_random_store(
        tmp_path / "s", fields=fields, clips={"train": 30}, n_frames=(2000, 2000), length=1000, stride=500,
        shard_bytes=1 << 30,
    )  # fmt: skip
    size = (tmp_path / "s" / TRAIN).stat().st_size
    tracemalloc.start()
    try:
        assert verify_store(tmp_path / "s") == []
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert size > 90e6
    assert peak < 30e6


def test_a_tempo_that_is_infinite_is_unknown(make_store: Any) -> None:
    made = make_store()
    edit(made.path, "clips/tempo_bpm", 0, np.inf)
    with open_store(made.path) as store:
        assert next(iter(store.clips)).tempo_bpm is None

"""Datasets of format 1, written by the last commit that wrote it (dea1fd6), are read as they were then."""

import hashlib
import json
import pickle
import shutil
from pathlib import Path
from typing import Any

import h5py
import pytest

from dancedata.store import Store, open_store, verify_store

FOLDER = Path(__file__).parent / "format1"
THEN: dict[str, Any] = json.loads((FOLDER / "read.json").read_text())
NAMES = (
    "id", "split", "n_frames", "genre", "music", "dancer", "tempo_bpm", "source", "n_flags", "trim_start", "height_m",
    "source_rate", "lists",
)  # fmt: skip


def rows_read(store: Store) -> str:
    """Hash all stored windows and, in track scope, others, as when the stores were frozen."""
    digest = hashlib.sha256()
    for split in store.splits:
        others = {"length_frames": 12, "stride_frames": 4, "trim": True}
        for windows in ({}, *([others] if store.scope == "track" else [])):
            for window in store.windows(split, **windows):
                for field in store.fields:
                    digest.update(f"{window} {field}".encode() + store.read(window, field).tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize("name", THEN)
def test_what_was_read_then_is_read_now(name: str) -> None:
    store, then = open_store(FOLDER / name), THEN[name]
    assert store.meta["format"] == 1
    assert rows_read(store) == then["rows"]
    clips = [[getattr(clip, column) for column in NAMES] for clip in store.clips]
    assert [[list(v) if isinstance(v, tuple) else v for v in clip] for clip in clips] == then["clips"]
    assert (store.quality, store.rejects) == (then["quality"], then["rejects"])
    assert {split: len(store.windows(split)) for split in store.splits} == then["windows"]
    assert rows_read(pickle.loads(pickle.dumps(store))) == then["rows"]


@pytest.mark.parametrize("name", THEN)
def test_it_is_checked(name: str) -> None:
    assert verify_store(FOLDER / name) == []


def test_it_has_no_groups_songs_or_segments() -> None:
    store = open_store(FOLDER / "track")
    clip = store.clips[0]
    assert (clip.group, clip.member, clip.song, clip.columns) == ("", -1, "", {})
    assert (store.layers, store.segments(clip.id)) == ((), [])


def test_hashes_of_sources_are_those_of_the_record() -> None:
    clips = {clip.id: clip.made_of for clip in open_store(FOLDER / "track").clips}
    assert clips["train_c00"] == "0123456789abcdef0123456789abcdef0123"
    assert clips["train_c01"] == "0123456789ac" + "0" * 12 + "89abcdef0124"
    assert clips["train_c02"] == ""


def test_a_trainer_reads_it() -> None:
    pytest.importorskip("torch")
    from dancedata.readers import WindowDataset

    dataset = WindowDataset(FOLDER / "track", "train", fields=("pose",), normalize=True)
    assert dataset[0]["pose"].shape == (20, 3)


def test_damage_is_named(tmp_path: Path) -> None:
    shutil.copytree(FOLDER / "track", tmp_path / "store")
    shard = next((tmp_path / "store").glob("train-*.h5"))
    with h5py.File(shard, "r+") as file:
        file["windows/start"][0] = 1000
    [problem] = [p for p in verify_store(tmp_path / "store") if p.severity == "error"]
    assert "bytes have changed" in problem.message

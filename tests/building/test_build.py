"""Builds: equal bytes in every way of building, nothing computed twice, foreign files untouched."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import soundfile

import dancedata
from dancedata.building import build as build_module
from dancedata.building.describe import describe_store
from dancedata.core.errors import DataError, SourceError, StoreError, UsageError
from dancedata.datasets.aistpp import AistPP
from tests.messages import raises_message

Hashes = Callable[[Path], dict[str, str]]
TRAIN = "gHO_sBM_cAll_d19_mHO3_ch03"
FILES = {
    "README.md", "dataset.json", "rejects.jsonl", "stats.json", "train-00000-of-00001.h5", "val-00000-of-00001.h5",
    "test-00000-of-00001.h5", "tables.h5", "local.json",
}  # fmt: skip


def break_clip(source: Path, clip: str = TRAIN) -> None:
    """Leave half of a motion pickle."""
    path = source / "motions" / f"{clip}.pkl"
    path.write_bytes(path.read_bytes()[:1000])


def test_the_second_time_nothing_is_done(run_build: Any, corpus: Path, built_copy: Path):
    before = {p: (p.stat().st_mtime_ns, p.stat().st_ino) for p in built_copy.iterdir()}
    assert run_build(corpus, built_copy).built is False
    assert {p: (p.stat().st_mtime_ns, p.stat().st_ino) for p in built_copy.iterdir()} == before


def test_another_recipe_is_refused_with_the_difference(run_build, corpus, built_copy, hashes):
    before = hashes(built_copy)
    with raises_message(StoreError, "different", where="outs/out"):
        run_build(corpus, built_copy, set=["windows.stride_s=1", "audio.librosa35.tightness=50"])
    assert hashes(built_copy) == before


@pytest.mark.parametrize("through_a_link", [False, True])
def test_overwrite_puts_the_new_dataset_in_the_place_of_the_old(run_build, corpus, built_copy, through_a_link):
    link = built_copy.parent.parent / "link"
    link.symlink_to(built_copy)
    assert run_build(corpus, link if through_a_link else built_copy, set=["windows.stride_s=1"], overwrite=True).built
    assert link.is_symlink()
    assert {p.name for p in built_copy.iterdir()} == FILES
    assert [p.name for p in built_copy.parent.iterdir()] == ["out"]
    with dancedata.open(built_copy) as ds:
        assert [w.start for w in ds.windows("val")] == [0, 30]


def test_overwrite_that_fails_leaves_the_old_dataset(run_build, corpus, built_copy, hashes, monkeypatch):
    def fail(folder: Path, *args: Any, **options: Any) -> None:
        (folder / "stats.json").write_text("half")
        raise StoreError("the disk is full")

    before = hashes(built_copy)
    monkeypatch.setattr(build_module, "write_store", fail)
    with raises_message(StoreError, "full"):
        run_build(corpus, built_copy, set=["windows.stride_s=1"], overwrite=True)
    monkeypatch.chdir(built_copy)
    with raises_message(UsageError, "working", where="outs/out"):
        run_build(corpus, built_copy, overwrite=True)
    assert hashes(built_copy) == before
    assert [p.name for p in built_copy.parent.iterdir()] == ["out"]


def test_strict_does_not_take_a_dataset_that_left_a_broken_clip_out(run_build: Any, source: Path, out: Path):
    break_clip(source)
    assert run_build(source, out).built
    assert run_build(source, out).built is False
    with pytest.raises(DataError, match="1 broken clip in a strict build"):
        run_build(source, out, strict=True)


@pytest.mark.parametrize(("recipe", "windows"), [("aist++", 3), ("aist++-edge-exact", 2)])
def test_music_that_ends_within_the_last_frame_of_a_window(run_build, source, out, recipe, windows):
    """A window needs music at its last instant, 5.967 s here; a slice for 6 s of samples, as EDGE's."""
    for song in (source / "wavs").glob("*.wav"):
        samples, rate = soundfile.read(song, dtype="int16")
        soundfile.write(song, samples[: int(5.983 * rate)], rate)
    run_build(source, out, recipe)
    with dancedata.open(out) as ds:
        assert {len(ds.windows(split)) for split in ds.splits if ds.windows(split)} <= {windows, 2 * windows}
    assert ("as EDGE counts" in describe_store(out)) == (windows == 2)


def test_two_clips_of_one_id_are_named_before_anything_is_computed(run_build, corpus, out, monkeypatch):
    plain = AistPP.scan

    def scan(self: AistPP, source: Path) -> Any:
        found = plain(self, source)
        first, second, *rest = found.clips
        return replace(found, clips=(first, replace(second, id=first.id), *rest))

    monkeypatch.setattr(AistPP, "scan", scan)
    with raises_message(SourceError, "different"):
        run_build(corpus, out)

"""A dataset does not depend on what filled the cache before: another stride, a killed build.

In window scope, features of windows share work with their neighbours, and so a build that finds some of them in its
cache computes the others in other groups than a fresh one. On a kernel for AVX2, which results are computed with,
the first release gave other bits then.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import soundfile

from dancedata.synthetic import write_synthetic

RECIPE = "aist++-edge-exact"


@pytest.fixture(scope="module")
def songs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight clips of 10 s to two songs: some 90 windows, of which four clips each share most."""
    return write_synthetic(tmp_path_factory.mktemp("songs") / "source", songs=2, clips_per_song=4, clip_s=10)


@pytest.fixture(scope="module")
def fresh(songs: Path, run_build: Callable, hashes: Callable, tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("fresh")
    run_build(songs, folder / "out", RECIPE, cache=folder / "cache")
    return hashes(folder / "out")


@pytest.mark.parametrize("first", ["another stride", "killed"])
def test_a_cache_filled_by_other_processes(songs, fresh, run_build, hashes, tmp_path, first):
    cache = tmp_path / "cache"
    if first == "another stride":
        run_build(songs, tmp_path / "before", RECIPE, ["windows.stride_s=1.5"], cache=cache)
    else:
        # As left by a build killed within a unit: some of its windows.
        run_build(songs, tmp_path / "before", RECIPE, cache=cache)
        for path in sorted((cache / "features").rglob("*.npy"))[::3]:
            path.unlink()
    run_build(songs, tmp_path / "out", RECIPE, cache=cache)
    assert hashes(tmp_path / "out") == fresh


def test_equal_windows_of_two_songs(run_build: Callable, hashes: Callable, songs: Path, tmp_path: Path) -> None:
    """A song that is cut out of another has equal windows at other places: they differ by rounding, and may."""
    source = shutil.copytree(songs, tmp_path / "source")
    one, two = sorted((source / "wavs").glob("*.wav"))
    samples, rate = soundfile.read(one, dtype="int16")
    soundfile.write(two, samples[rate // 2 :], rate)
    for order in ("one", "two"):
        half = shutil.copytree(source, tmp_path / order)
        for path in (half / "motions").glob("*.pkl"):
            if {"one": one, "two": two}[order].stem not in path.name:
                path.unlink()
        run_build(half, tmp_path / f"half-{order}", RECIPE, cache=tmp_path / f"cache-{order}")
        run_build(source, tmp_path / f"out-{order}", RECIPE, cache=tmp_path / f"cache-{order}")
    assert hashes(tmp_path / "out-one") == hashes(tmp_path / "out-two")

"""Full disks, clocks that go backwards, entries that are lost: a correct store or a clear error, never a half one."""

import errno
import io
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.building import build as build_module
from dancedata.building.build import build
from dancedata.building.part import Part, build_part
from dancedata.core.errors import DanceDataError, StoreError
from dancedata.datasets.aistpp import AistPP
from dancedata.execution.cache import Cache
from dancedata.execution.cache_admin import verify_cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units
from dancedata.files import cache_files
from dancedata.recipes.parse import parse_recipe
from dancedata.store import verify_store
from tests.execution.test_cache import damage

DOCUMENT: dict[str, Any] = {
    "recipe": 1,
    "name": "faults",
    "dataset": {"aist++": {"music": "optional"}},
    "windows": {"length_s": 5, "stride_s": 0.5},
    "motion": {"edge151": {}},
}
RECIPE = parse_recipe(DOCUMENT)
Build = Callable[..., Any]


@pytest.fixture
def run(corpus: Path, out: Path, tmp_path: Path) -> Build:
    """Build motion only, in this process."""
    return lambda **options: build(RECIPE, corpus, out, **{"cache": tmp_path / "cache", **options})


@pytest.fixture(scope="module")
def whole(corpus: Path, tmp_path_factory: pytest.TempPathFactory, hashes: Any) -> dict[str, str]:
    """Hashes of an undisturbed build of the same."""
    folder = tmp_path_factory.mktemp("whole")
    build(RECIPE, corpus, folder / "whole", cache=folder / "cache")
    return dict(hashes(folder / "whole"))


def strays(cache: Path) -> list[Path]:
    return [p for name in ("tmp", "locks") for p in (cache / name).glob("*")]


@pytest.mark.parametrize("written", [0, 3, 7, 12, 20, 21, 25, 30])
def test_a_disk_that_fills_up_is_a_clear_error_and_room_mends_it(
    run, out, tmp_path, whole, hashes, monkeypatch, written
):
    """The disk takes this many writes of the cache and flushes of the store, then is full."""
    left = written

    def limited(original: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            nonlocal left
            left -= 1
            if left < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return original(*args)

        return call

    with monkeypatch.context() as full:
        full.setattr(cache_files, "_write_all", limited(cache_files._write_all))
        full.setattr(os, "fsync", limited(os.fsync))
        with pytest.raises(StoreError, match=r"No space left on device") as caught:
            run()
    assert "cannot be written" in str(caught.value)
    assert not (out / "dataset.json").exists()
    assert strays(tmp_path / "cache") == []
    run()
    assert hashes(out) == whole
    assert [p for p in verify_store(out) if p.severity == "error"] == []


#: Files may not be larger than this many bytes, as with an exhausted quota.
LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
from dancedata.cli.app import main
main()
"""


def test_a_quota_is_a_clear_error(slow: Any, corpus: Path, out: Path, undisturbed: Any, hashes: Any):
    arguments = slow.command(corpus, "--out", out, "--jobs", 1)[3:]
    for size in (100, 60_000):
        command = [sys.executable, "-B", "-c", LIMITED, str(size), *arguments]
        done = subprocess.run(command, env=slow.environment, capture_output=True, text=True, check=False)
        assert done.returncode == 1, done.stderr
        assert "cannot be written; found [Errno 27] File too large" in done.stderr
        assert not out.exists()
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert slow.strays() == []


def test_out_may_be_a_volume_of_its_own(corpus: Path, tmp_path: Path, whole: dict[str, str], hashes: Any):
    """As in a container: the folder above is on another file system, and OUT cannot be renamed."""
    out = tmp_path / "volume"
    out.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=20m", "tmpfs", str(out)], capture_output=True).returncode:
        pytest.skip("a tmpfs cannot be mounted here")
    try:
        build(RECIPE, corpus, out, cache=tmp_path / "cache")
        assert hashes(out) == whole
        with pytest.raises(StoreError, match="the output folder cannot be written"):
            build(replace(RECIPE, shard_mb=1), corpus, out, cache=tmp_path / "cache", overwrite=True)
        assert hashes(out) == whole
        assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
    finally:
        subprocess.run(["umount", str(out)], check=True)


def test_a_clock_that_goes_backwards_changes_nothing(run, out, tmp_path, whole, hashes, monkeypatch):
    now = time.time()

    def backwards() -> float:
        nonlocal now
        now -= 5000.0
        return now

    with monkeypatch.context() as clock:
        clock.setattr(time, "time", backwards)
        run()
        assert hashes(out) == whole
        shutil.rmtree(out)
        run()
    assert hashes(out) == whole
    # Entries from the future are as good as others.
    for path in (tmp_path / "cache").rglob("*.*"):
        os.utime(path, (now + 1e8, now + 1e8))
    shutil.rmtree(out)
    run()
    assert hashes(out) == whole


@pytest.mark.parametrize("how", ["removed", "damaged"])
def test_an_entry_that_is_lost_during_a_build_is_computed_again(run, out, tmp_path, whole, hashes, monkeypatch, how):
    """`dancedata cache prune` may run at any time, and disks have their moods."""
    compute = build_module.compute_clips

    def losing(*args: Any, **options: Any) -> Any:
        clips = compute(*args, **options)
        path = sorted((tmp_path / "cache" / "motion").rglob("*.npy"))[0]
        if how == "removed":
            path.unlink()
        else:
            data = bytearray(path.read_bytes())
            data[len(data) // 2] ^= 1
            path.write_bytes(data)
        monkeypatch.setattr(build_module, "compute_clips", compute)
        return clips

    monkeypatch.setattr(build_module, "compute_clips", losing)
    run()
    assert hashes(out) == whole


@pytest.mark.parametrize("jobs", [1, 2])
def test_any_number_of_damaged_entries_cost_a_computation_each(corpus, out, tmp_path, hashes, monkeypatch, jobs):
    fields = ("edge151", "lodge139", "finedance319", "joints", "fact219")
    recipe = parse_recipe({**DOCUMENT, "motion": {name: {} for name in fields}})
    cache = tmp_path / "cache"
    build(recipe, corpus, out, cache=cache)
    whole = hashes(out)
    shutil.rmtree(out)
    assert damage(cache) == 40
    loaded: list[str] = []
    load = AistPP.load

    def counted(self: AistPP, ref: Any) -> Any:
        loaded.append(ref.id)
        return load(self, ref)

    monkeypatch.setattr(AistPP, "load", counted)
    stream = io.StringIO()
    build(recipe, corpus, out, cache=cache, jobs=jobs, progress=Progress(stream=stream))
    assert hashes(out) == whole
    assert verify_cache(cache) == (len(list(cache.rglob("*.json"))) + 40, [])
    assert stream.getvalue().count("an entry of the cache is damaged") == 1
    if jobs == 1:  # else it is other processes that load
        assert sorted(loaded) == sorted(set(loaded))
        assert len(loaded) == 8


def test_damaged_entries_that_a_filter_reads(corpus: Path, out: Path, tmp_path: Path, hashes: Any):
    """They are met while clips are gathered, also by a part that writes no dataset."""
    rules = {"movement": {"min_std": 0.001, "field": "edge151"}}
    recipe = parse_recipe({**DOCUMENT, "rules": rules})
    cache = tmp_path / "cache"
    build(recipe, corpus, out, cache=cache)
    whole = hashes(out)
    shutil.rmtree(out)
    for run in (
        lambda: build_part(recipe, corpus, Part(1, 1), cache=cache),
        lambda: build(recipe, corpus, out, cache=cache),
    ):
        assert damage(cache) == 8
        run()
        assert verify_cache(cache)[1] == []
    assert hashes(out) == whole


def test_entries_that_are_lost_every_time_end_the_build(run, out, tmp_path, monkeypatch):
    compute = build_module.compute_clips

    def losing(*args: Any, **options: Any) -> Any:
        clips = compute(*args, **options)
        shutil.rmtree(tmp_path / "cache" / "motion")
        return clips

    monkeypatch.setattr(build_module, "compute_clips", losing)
    with pytest.raises(StoreError, match="an entry of the cache is gone"):
        run()
    assert not (out / "dataset.json").exists()


def test_a_full_cache_that_is_read_only_is_enough(run, corpus, out, tmp_path, whole, hashes, monkeypatch):
    run()
    shutil.rmtree(out)

    def refuse(*args: Any, **options: Any) -> Any:
        raise PermissionError(errno.EACCES, "read-only")

    monkeypatch.setattr(cache_files, "open_locked", refuse)
    monkeypatch.setattr(cache_files, "file_lock", refuse)
    monkeypatch.setattr(os, "utime", refuse)
    monkeypatch.setattr(os, "access", lambda path, mode: "cache" not in str(path))
    run()
    assert hashes(out) == whole


def test_where_the_file_system_has_no_locks_builds_work(run, out, tmp_path, whole, hashes, monkeypatch):
    def none(fd: int, operation: int) -> None:
        raise OSError(errno.ENOSYS, "no locks")

    monkeypatch.setattr("fcntl.flock", none)
    run()
    assert hashes(out) == whole
    stray = tmp_path / "cache" / "tmp" / f"dancedata-{0:032x}.tmp"
    stray.touch()
    shutil.rmtree(out)
    run()
    assert stray.exists(), "it may be a foreign file"
    os.utime(stray, (0, 0))
    shutil.rmtree(out)
    run()
    assert not stray.exists()


def test_files_of_a_running_process_are_kept(tmp_path: Path):
    cache = Cache(tmp_path)
    names = [f"dancedata-{number:032x}.tmp" for number in range(2)]
    with cache.lock("features", f"{0:064x}"), cache_files.locked_file(tmp_path / "tmp", names[0]):
        (tmp_path / "tmp" / names[1]).touch()
        (tmp_path / "locks" / f"features-{1:064x}").touch()
        assert cache_files.sweep(tmp_path) == 2
        assert len(strays(tmp_path)) == 2
    assert strays(tmp_path) == []


def test_a_worker_that_cannot_write_to_the_cache_says_so():
    # A folder in which no user can create a file.
    cache = Cache(Path("/proc/self/fd"))
    calls = [("features", f"{number:064x}", partial(np.zeros, 3)) for number in range(2)]
    with pytest.raises(DanceDataError, match="the cache cannot be written"):
        run_units(cache.once, calls, jobs=2, label="x", progress=Progress(quiet=True))

"""Throughput of writing a dataset, compared with plain writing and h5py: MB of files per second, wall and CPU.

    python benchmarks/writing.py RECIPE SOURCE CACHE FOLDER

Every unit of work has to be in CACHE already; `python benchmarks/build.py aistpp` calls this after its builds. Three
ways alternately, each in a separate process, twice; the second round counts, as the cache is in memory then:

write_store  what a build does: reads cache entries and compares their checksums, checks every value, writes and
             flushes the shards, hashes them, computes statistics.
h5py         reads the same entries (with their checksums), `create_dataset(data=array)` one by one into one file,
             flushed.
plain        reads the finished shards by pieces of 8 MiB and writes them one after another, each flushed.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dancedata.building import build as build_module
from dancedata.recipes.parse import load_recipe
from dancedata.store import write_store

WAYS = ("plain", "h5py", "write_store")
PIECE = 1 << 23


class _CaughtError(Exception):
    """Ends a build where it would write."""


def main() -> None:
    """Run every way in a separate process, twice, or one way if it is named."""
    recipe, source, cache, folder, *way = sys.argv[1:]
    if way:
        one(way[0], recipe, Path(source), Path(cache), Path(folder))
        return
    one("write_store", recipe, Path(source), Path(cache), Path(folder), quiet=True)  # the shards that "plain" copies
    for _ in range(2):
        for name in WAYS:
            subprocess.run([sys.executable, __file__, recipe, source, cache, folder, name], check=True)


def one(way: str, recipe: str, source: Path, cache: Path, folder: Path, quiet: bool = False) -> None:
    """Write in one way and print time and memory."""
    header, clips, arguments = caught(recipe, source, cache, folder)
    target = folder / way
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    begun, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
    if way == "plain":
        plain(folder / "write_store", target)
    elif way == "h5py":
        with_h5py(clips, target / "all.h5")
    else:
        write_store(target, header, clips, **arguments)
    wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    size = sum(path.stat().st_size for path in target.iterdir()) / 1e6
    if not quiet:
        print(
            f"  {way:<12} {size:6.0f} MB  wall {wall:6.1f} s, {size / wall:6.0f} MB/s  CPU {cpu:6.1f} s, "
            f"{size / cpu:6.0f} MB per CPU s  (load {os.getloadavg()[0]:.1f})",
            flush=True,
        )
    if way != "write_store":
        shutil.rmtree(target)


def caught(recipe: str, source: Path, cache: Path, folder: Path) -> tuple[Any, Any, dict[str, Any]]:
    """Return what a build gives to `write_store`."""
    found: list[Any] = []

    def catch(out: Path, header: Any, clips: Any, **arguments: Any) -> None:
        arguments.pop("progress", None)
        found.extend((header, clips, arguments))
        raise _CaughtError

    build_module.write_store = catch
    with suppress(_CaughtError):
        build_module.build(load_recipe(recipe), source, folder / "caught", jobs=1, cache=cache)
    header, clips, arguments = found
    return header, clips, arguments


def plain(shards: Path, target: Path) -> None:
    """Copy the shards, one after another."""
    buffer = memoryview(bytearray(PIECE))
    for path in sorted(shards.glob("*.h5")):
        with open(path, "rb", buffering=0) as read, open(target / path.name, "wb", buffering=0) as write:
            while n := read.readinto(buffer):
                write.write(buffer[:n])
            os.fsync(write.fileno())


def with_h5py(clips: Any, path: Path) -> None:
    """Write every array as a dataset."""
    with h5py.File(path, "w", libver="latest") as file:
        for number, array in enumerate(arrays(clips)):
            file.create_dataset(str(number), data=np.asarray(array))
    with open(path, "rb+") as written:
        os.fsync(written.fileno())


def arrays(clips: Any) -> Iterator[Any]:
    """Yield the arrays of all clips, equal ones once per split, as shards have them."""
    seen = set()
    for clip in clips:
        yield from clip.motion.values()
        for name, block in clip.audio.items():
            if (clip.split, name, block.key) not in seen:
                seen.add((clip.split, name, block.key))
                yield block.array


if __name__ == "__main__":
    main()

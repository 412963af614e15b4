"""A million clips: time and memory from opening a dataset to the first sample, in each of four processes.

    python benchmarks/million.py                  1,000,000 clips, 11,000,000 windows; sparse files under --work
    python benchmarks/million.py --clips 100000

The tables are synthetic: every clip has 350 frames and 11 windows of 150; rows are zeros of a sparse file. Printed
are, per process, wall seconds and the growth of its anonymous memory (without pages of mapped files, from
/proc/self/smaps_rollup) after each step, and the whole RSS; torch is imported before. Files are in the page cache.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

FRAMES, WINDOWS, STRIDE, LENGTH = 350, 11, 20, 150


def lay_out(folder: Path, n: int) -> dict[str, Any]:
    """Write a small store, and a sparse shard of the rows of n clips; return its dataset.json, to be sealed."""
    from dancedata.store import hdf5
    from dancedata.store.hdf5 import SparseFile
    from dancedata.testing.stores import random_fields, write_random_store

    fields = random_fields({"pose": 3}, {"music": 2})
    write_random_store(
        folder, clips={"train": 10}, fields=fields, n_frames=(FRAMES, FRAMES), length=LENGTH, stride=STRIDE,
        clips_per_song=10,
    )  # fmt: skip
    info: dict[str, Any] = json.loads((folder / "dataset.json").read_text())
    entry, rows = info["shards"][0], n * FRAMES
    layout = SparseFile()
    with hdf5.create_file(layout) as file:
        for name, path, width in (("pose", "motion/pose", 3), ("music", "audio/music", 2)):
            dataset = hdf5.create_dataset(file, path, (rows, width), "<f4")
            entry["fields"][name] = [int(dataset.id.get_offset()), rows]
    shard = folder / entry["file"]
    with open(shard, "wb") as target:
        layout.copy_to(target)
    os.truncate(shard, max(shard.stat().st_size, entry["fields"]["music"][0] + rows * 8))
    info["shards"][0] |= {"size": shard.stat().st_size, "clips": n, "windows": n * WINDOWS}
    return info


def write(folder: Path, n: int) -> None:
    """Write a small store, and put the tables of n clips into the place of its own."""
    from dancedata.store import hdf5
    from dancedata.store.hdf5 import SparseFile

    info = lay_out(folder, n)
    numbers = np.arange(n)
    texts = {"id": [f"clip{k:07d}" for k in range(n)], "genre": ["break"] * n, "music": ["songaaaa"] * n}
    texts |= {"split": ["train"] * n, "file": [info["shards"][0]["file"]] * n}
    layout = SparseFile()
    with hdf5.create_file(layout) as file:
        hdf5.write_attributes(file, format=info["format"], fps=info["fps"])
        for name, values in texts.items():
            hdf5.write_strings(file, f"clips/{name}", values, 128)
        hdf5.write_array(file, "clips/n_frames", np.full(n, FRAMES, np.int32))
        for name in ("motion/pose", "audio/music"):
            hdf5.write_array(file, f"clips/{name}/start", numbers * FRAMES)
            hdf5.write_array(file, f"clips/{name}/length", np.full(n, FRAMES, np.int32))
        hdf5.write_array(file, "clips/audio/music/offset", np.zeros(n, np.int64))
        hdf5.write_array(file, "windows/clip", np.repeat(numbers, WINDOWS).astype(np.int32))
        hdf5.write_array(file, "windows/start", np.tile(np.arange(WINDOWS) * STRIDE, n).astype(np.int32))
    with open(folder / "tables.h5", "wb") as target:
        layout.copy_to(target)
    seal(folder, info, "tables.h5")


def seal(folder: Path, info: dict[str, Any], tables: str) -> None:
    """Write dataset.json with size and hash of the file of tables."""
    from dancedata.core.hashing import json_sha256, sha256_bytes

    data = (folder / tables).read_bytes()
    files = info["files"] if tables in info["files"] else info["splits"]["train"]
    files["tables" if files is not info["files"] else tables] |= {"size": len(data), "sha256": sha256_bytes(data)}
    del info["self_sha256"]
    (folder / "dataset.json").write_text(json.dumps({**info, "self_sha256": json_sha256(info)}))


def memory_mb() -> tuple[float, float]:
    """Return anonymous memory and RSS of this process, MB."""
    text = Path("/proc/self/smaps_rollup").read_text()
    lines = dict(line.split(":") for line in text.splitlines()[1:] if ":" in line)
    return int(lines["Anonymous"].split()[0]) / 1e3, int(lines["Rss"].split()[0]) / 1e3


def read(folder: Path, results: Any) -> None:
    """Open, list, and read a first sample."""
    import torch  # noqa: F401
    from torch.utils.data import DataLoader

    import dancedata
    from dancedata.torch import EpochSampler, WindowDataset

    steps: dict[str, Any] = {}
    before, begin = memory_mb()[0], time.perf_counter()

    def note(step: str) -> None:
        own, rss = memory_mb()
        steps[step] = (time.perf_counter() - begin, own - before, rss)

    store = dancedata.open(folder)
    note("open")
    dataset = WindowDataset(store, fields=("pose", "music"), scale=None)
    note("WindowDataset")
    dataset[len(dataset) // 2]
    note("first sample")
    next(iter(DataLoader(dataset, 64, sampler=EpochSampler(len(dataset), seed=1))))
    note("first shuffled batch")
    results.put(steps)


def main() -> None:
    """Write, read in four processes, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clips", type=int, default=1_000_000)
    parser.add_argument("--processes", type=int, default=4)
    parser.add_argument("--work", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.work) as work:
        folder = Path(work) / "store"
        begin = time.perf_counter()
        write(folder, options.clips)
        tables = (folder / "tables.h5").stat().st_size / 1e6
        print(f"{options.clips:,} clips, {options.clips * WINDOWS:,} windows, tables {tables:.0f} MB")
        print(f"written in {time.perf_counter() - begin:.1f} s; {options.processes} processes at once")
        context = multiprocessing.get_context("spawn")
        results = context.Queue()
        processes = [context.Process(target=read, args=(folder, results)) for _ in range(options.processes)]
        for process in processes:
            process.start()
        found = [results.get(timeout=600) for _ in processes]
        for process in processes:
            process.join()
    print(f"{'after':24}{'seconds':>16}{'own memory MB':>20}{'RSS MB':>16}")
    for step in found[0]:
        seconds, own, rss = zip(*(steps[step] for steps in found), strict=True)
        ranges = [f"{min(values):.2f} to {max(values):.2f}" for values in (seconds, own, rss)]
        print(f"{step:24}{ranges[0]:>16}{ranges[1]:>20}{ranges[2]:>16}")


if __name__ == "__main__":
    main()

"""Reading batches: this package against other formats behind a DataLoader, all in one run on one machine.

    python benchmarks/reading.py                    3,000 windows, 0, 1 and 2 workers, 5 rounds; 32 GB under --work
    python benchmarks/reading.py --quick            336 windows, 2 rounds
    python benchmarks/reading.py --wide 0           without the wide field
    python benchmarks/reading.py --peers memmap     against fewer (always against np.load)

A window is (150, 151) float32, (150, 35) float32 and (150, 4800) float16; batches of 64 in a random order, which is
the same for all loaders with random access (WebDataset and LitData read their files in order, which is their best
case). Every loader returns dicts of the same three arrays; the first batch of each is compared with the source. The
other formats store every window by itself, this package stores 125 tracks of 24 overlapping windows.

A measurement is one epoch of one loader, from iter() to the last batch, including the start of workers; one number of
each array of a batch is read. Before it, outside the clock, the loader's files are read once, so that they are in the
page cache. Rounds are interleaved: each measures every loader once, in a new order, except that loaders of the same
files are consecutive: all files together need not fit into memory. Medians over rounds.

The memory-copy rate is that of numpy copying 4.6 GB, batch by batch, from a large array in memory into one reused
buffer per thread, with as many threads as the BatchLoader has; bytes copied per second, not read plus written.

Peers that are not installed (webdataset, litdata, zarr) are named and skipped.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import random
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from reading_peers import BATCH, PEERS, NpLoad, Source
from torch.utils.data import DataLoader

from dancedata.testing.stores import random_fields, write_random_store
from dancedata.torch import BatchLoader, EpochSampler, WindowDataset

LENGTH, STRIDE, PER_CLIP = 150, 15, 24
GATES = {"DataLoader / best peer": 0.9, "BatchLoader / np.load": 5.0, "BatchLoader / memory copy": 0.5}
Measure = Callable[[], Iterable[dict[str, Any]]]


def main() -> int:
    """Write the missing data, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="336 windows, 2 rounds")
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--wide", type=int, default=4800, help="columns of the wide field; 0: without it")
    parser.add_argument("--peers", nargs="*", help="only peers whose name contains one of these")
    parser.add_argument("--work", type=Path, help="folder for the data; kept. Default: a temporary one")
    parser.add_argument("--json", type=Path, help="file to write all measurements to, too")
    arguments = parser.parse_args()
    rounds = arguments.rounds or (2 if arguments.quick else 5)
    with tempfile.TemporaryDirectory() as temporary:
        source = make_source(arguments.work or Path(temporary), 336 if arguments.quick else 3000, arguments.wide)
        measures = measures_of(source, arguments.peers)
        print(machine(source, rounds), flush=True)
        check(source, measures)
        found = measure(source, measures, rounds, arguments.json)
    print_table(source, found)
    return 0 if print_gates(found) else 1


def make_source(work: Path, n_windows: int, wide: int) -> Source:
    """Write the store unless it exists; the first `n_windows` of its train split are read."""
    folder = work / f"reading-{n_windows}-{wide}"
    n_clips = -(-n_windows // PER_CLIP)
    n_frames = LENGTH + STRIDE * (PER_CLIP - 1)
    motion, music, more = random_fields({"edge151": 151}, {"librosa35": 35, "wide": max(1, wide)})
    fields = (motion, music, replace(more, dtype="float16"))[: 3 if wide else 2]
    if not (folder / "store" / "dataset.json").exists():
        write_random_store(
            folder / "store", clips={"train": n_clips}, fields=fields, length=LENGTH, stride=STRIDE,
            n_frames=(n_frames, n_frames), clips_per_song=1, shard_bytes=256 << 20,
        )  # fmt: skip
    return Source(folder, WindowDataset(folder / "store", fields=[f.name for f in fields], scale=None))


def measures_of(source: Source, peers: Sequence[str] | None) -> dict[tuple[str, int], tuple[Measure, Path]]:
    """Return by (name, workers) a function that makes the loader, and the folder that it reads."""
    kinds = [k for k in PEERS if k is NpLoad or peers is None or any(p.lower() in k.name.lower() for p in peers)]
    dataset, store = source.dataset, source.dataset.store.path
    augmented = WindowDataset(store, fields=source.fields, augment={"mirror": 0.5})
    found: dict[tuple[str, int], tuple[Measure, Path]] = {}
    for kind in kinds:
        if kind.package is not None and importlib.util.find_spec(kind.package) is None:
            print(f"{kind.name}: skipped, {kind.package} is not installed")
            continue
        peer = kind(source)
        if not (peer.folder / "done").exists():
            shutil.rmtree(peer.folder, ignore_errors=True)
            peer.folder.mkdir(parents=True)
            peer.write(source)
            (peer.folder / "done").touch()
        for workers in (0, 1, 2):
            found[kind.name, workers] = (lambda p=peer, w=workers: p.loader(w)), peer.folder

    def plain(windows: WindowDataset, workers: int) -> Measure:
        return lambda: DataLoader(windows, BATCH, sampler=EpochSampler(windows, seed=0), num_workers=workers)

    for workers in (0, 1, 2):
        found["dancedata, DataLoader", workers] = plain(dataset, workers), store
        found["dancedata, DataLoader, mirrored + normalised", workers] = plain(augmented, workers), store
    datasets = (("dancedata, BatchLoader", dataset), ("dancedata, BatchLoader, mirrored + normalised", augmented))
    for name, windows in datasets:
        for threads in (1, 2):
            loader = BatchLoader(windows, BATCH, sampler=EpochSampler(windows), threads=threads)
            found[name, threads] = (lambda made=loader: from_the_start(made)), store
    return found


def from_the_start(loader: BatchLoader) -> BatchLoader:
    """Return the loader, which keeps its memory, at the start of epoch 0."""
    loader.sampler.load_state_dict({"epoch": 0, "position": 0})
    return loader


def check(source: Source, measures: dict[tuple[str, int], tuple[Measure, Path]]) -> None:
    """Compare the first batch of every loader with the source; the tests check the augmented ones.

    A BatchLoader also runs an epoch, so that its memory is allocated, as in training.
    """
    in_order = {kind.name for kind in PEERS if kind.in_order}
    for (name, workers), (make, _) in measures.items():
        if "BatchLoader" in name:
            epoch(make, source)
        if "mirrored" in name:
            continue
        order = [0] if name in in_order else EpochSampler(len(source), seed=0).order(0)[:BATCH].tolist()
        first = next(iter(make()))
        for field in source.fields:
            expected = np.stack([source.array(k, field) for k in order])
            if not np.array_equal(np.asarray(first[field])[: len(order)], expected):
                raise SystemExit(f"{name} with {workers} workers returned a wrong {field}")


def measure(
    source: Source, measures: dict[tuple[str, int], tuple[Measure, Path]], rounds: int, out: Path | None
) -> dict[tuple[str, int], list[float]]:
    """Return bytes per second of every round, by (name, workers); written to `out` after each."""
    copies = [("memory copy", 1), ("memory copy", 2)]
    found: dict[tuple[str, int], list[float]] = {name: [] for name in [*measures, *copies]}
    # The memory copy is compared with reading from the store.
    groups = {folder: [name for name in measures if measures[name][1] == folder] for _, folder in measures.values()}
    groups[source.dataset.store.path] += copies
    big = np.ones(1 << 30, dtype=np.uint8)
    dice = random.Random(0)
    for nth in range(rounds):
        order = dice.sample(list(groups.values()), len(groups))
        for name in [name for group in order for name in dice.sample(group, len(group))]:
            if name[0] == "memory copy":
                found[name].append(copy_rate(big, source.n_bytes, name[1]))
                continue
            make, folder = measures[name]
            warm(folder)
            found[name].append(source.n_bytes / epoch(make, source))
        if out is not None:
            out.write_text(json.dumps({f"{n}, {w}": v for (n, w), v in found.items()}, indent=1))
        print(f"round {nth + 1} of {rounds}, load {os.getloadavg()[0]:.1f}", file=sys.stderr, flush=True)
    return found


def epoch(make: Measure, source: Source) -> float:
    """Return the seconds of one epoch."""
    begin = time.perf_counter()
    n = 0
    for batch in make():
        n += len(batch[source.fields[0]])
        for name in source.fields:
            batch[name][0, 0, 0].item()
    seconds = time.perf_counter() - begin
    if n != len(source):
        raise SystemExit(f"{n} windows instead of {len(source)}")
    return seconds


def copy_rate(big: np.ndarray[Any, Any], n_bytes: int, threads: int) -> float:
    """Return bytes per second of plain copies into reused memory."""
    step = 96 << 20
    buffers = [np.ones(step, dtype=np.uint8) for _ in range(threads)]
    jobs = [k * step % (len(big) - step) for k in range(max(threads, n_bytes // step))]

    def work(thread: int) -> None:
        for begin in jobs[thread::threads]:
            np.copyto(buffers[thread], big[begin : begin + step])

    with ThreadPoolExecutor(threads) as pool:
        begin = time.perf_counter()
        list(pool.map(work, range(threads)))
        return len(jobs) * step / (time.perf_counter() - begin)


def warm(folder: Path) -> None:
    """Read all files, so that they are in the page cache."""
    buffer = bytearray(8 << 20)
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            with path.open("rb", buffering=0) as file:
                while file.readinto(buffer):
                    pass


def size_of(folder: Path) -> float:
    """Gigabytes on disk."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e9


def machine(source: Source, rounds: int) -> str:
    """Return the machine and the versions that the numbers depend on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    cpu = next((line.split(": ")[1] for line in lines if line.startswith("model name")), "").strip()
    names = ["numpy", "torch", "h5py", *(kind.package for kind in PEERS if kind.package)]
    versions = [f"{name} {version(name)}" for name in names if importlib.util.find_spec(name)]
    return (
        f"{cpu or platform.processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; "
        f"Python {platform.python_version()}, {', '.join(versions)}\n{len(source):,} windows, "
        f"{source.n_bytes / 1e9:.2f} GB; this package {size_of(source.folder / 'store'):.2f} GB on disk; "
        f"batches of {BATCH}; median of {rounds} interleaved rounds"
    )


def print_table(source: Source, found: dict[tuple[str, int], list[float]]) -> None:
    """Print medians."""
    print(f"\n{'loader':48} {'workers':>8} {'windows/s':>10} {'GB/s':>6} {'least':>6} {'most':>6} {'x np.load':>10}")
    for (name, workers), rates in sorted(found.items(), key=lambda item: (item[0][1], -statistics.median(item[1]))):
        rate = statistics.median(rates)
        peer = statistics.median(found[NpLoad.name, workers])
        threads = "threads" if "BatchLoader" in name or "copy" in name else "workers"
        print(
            f"{name:48} {workers} {threads[:6]:>6} {rate / source.n_bytes * len(source):10.0f} {rate / 1e9:6.2f} "
            f"{min(rates) / 1e9:6.2f} {max(rates) / 1e9:6.2f} {rate / peer:10.2f}"
        )


def print_gates(found: dict[tuple[str, int], list[float]]) -> bool:
    """Print the ratios with a gate, each the median over rounds; return whether all are met."""

    def ratio(one: Sequence[float], *others: Sequence[float]) -> float:
        return statistics.median(a / max(rest) for a, *rest in zip(one, *others, strict=True))

    kinds = [kind.name for kind in PEERS if (kind.name, 0) in found]
    rows: list[tuple[str, str, float]] = []
    for workers in (0, 1, 2):
        ours, peers = found["dancedata, DataLoader", workers], [found[name, workers] for name in kinds]
        rows.append(("DataLoader / best peer", f"{workers} workers", ratio(ours, *peers)))
    for workers in (0, 1, 2):
        ours, peer = found["dancedata, BatchLoader", 2], found[NpLoad.name, workers]
        rows.append(("BatchLoader / np.load", f"2 threads, {workers} workers", ratio(ours, peer)))
    for threads in (1, 2):
        ours = found["dancedata, BatchLoader", threads]
        rows.append(("BatchLoader / memory copy", f"{threads} threads", ratio(ours, found["memory copy", threads])))
    print()
    for what, where, value in rows:
        verdict = "met" if value >= GATES[what] else "MISSED"
        print(f"{what:28} {where:24} {value:6.2f}   at least {GATES[what]:g}: {verdict}")
    return all(value >= GATES[what] for what, _, value in rows)


if __name__ == "__main__":
    raise SystemExit(main())

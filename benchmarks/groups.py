"""A corpus of groups against as many single clips: time and memory of building and of reading, in one run.

    python benchmarks/groups.py                 2,000 clips of 6 s: 500 groups of 4, and 2,000 single dancers
    python benchmarks/groups.py --clips 200

Both are stores of random rows with edge151 and librosa35, written by `write_store`, and read by a BatchLoader of 2
threads in batches of 64 dancers; rounds alternate, medians are printed. Memory is the largest RSS of a process of its
own, which writes or reads one of them.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

SIZE, FRAMES = 4, 180


def build(folder: Path, n: int, grouped: bool) -> float:
    """Write a store; return the seconds."""
    from dancedata.store import write_store
    from dancedata.testing.stores import write_random_store

    draft = write_random_store(
        folder / "draft", clips={"train": SIZE}, n_frames=(FRAMES, FRAMES), length=150, stride=15, clips_per_song=SIZE
    )
    clips = []
    for k in range(n):
        group = k // SIZE
        clip = replace(draft.clips[k % SIZE], id=f"clip{k:06d}", music=f"song{group}")
        key = {name: replace(block, key=f"{name}{group}") for name, block in clip.audio.items()}
        shared = {"lists": (), "starts": draft.clips[0].starts}
        if grouped:
            clip = replace(clip, group=f"group{group:06d}", member=k % SIZE)
        clips.append(replace(clip, audio=key, **shared))
    out = folder / "store"
    out.mkdir()
    begin = time.perf_counter()
    write_store(out, draft.header, clips)
    return time.perf_counter() - begin


def read(folder: Path, n: int, grouped: bool) -> float:
    """Read an epoch in batches of 64 dancers; return the seconds."""
    from dancedata.torch import BatchLoader, GroupDataset, WindowDataset

    cls: Any = GroupDataset if grouped else WindowDataset
    dataset = cls(folder / "store", "train", fields=("edge151", "librosa35"), scale=None)
    begin = time.perf_counter()
    for batch in BatchLoader(dataset, 64 // SIZE if grouped else 64, shuffle=True):
        float(batch["edge151"].reshape(-1)[0])
    return time.perf_counter() - begin


def measured(work: Callable[[Path, int, bool], float], folder: Path, n: int, grouped: bool) -> tuple[float, float]:
    """Return seconds, and MB of the largest RSS, of a process that does it."""
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    process = context.Process(target=_child, args=(work, folder, n, grouped, results))
    process.start()
    found: tuple[float, float] = results.get(timeout=900)
    process.join()
    return found


def _child(work: Callable[[Path, int, bool], float], folder: Path, n: int, grouped: bool, results: Any) -> None:
    seconds = work(folder, n, grouped)
    results.put((seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3))


def main() -> None:
    """Measure in alternating rounds, print medians and ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clips", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    n = options.clips // SIZE * SIZE
    found: dict[tuple[str, bool], list[tuple[float, float]]] = {}
    for _ in range(options.rounds):
        for grouped in (False, True):
            with tempfile.TemporaryDirectory() as work:
                for step in (build, read, read):
                    found.setdefault((step.__name__, grouped), []).append(measured(step, Path(work), n, grouped))
    windows = n * ((FRAMES - 150) // 15 + 1)
    print(f"{n:,} clips, {windows:,} windows of dancers; groups of {SIZE}; medians of {options.rounds} rounds")
    print(f"{'':10}{'single s':>12}{'groups s':>12}{'ratio':>8}{'single MB':>12}{'groups MB':>12}")
    for step in ("build", "read"):
        (one, one_mb), (two, two_mb) = (
            [statistics.median(values) for values in zip(*found[step, grouped], strict=True)]
            for grouped in (False, True)
        )
        print(f"{step:10}{one:12.2f}{two:12.2f}{two / one:8.2f}{one_mb:12.0f}{two_mb:12.0f}")


if __name__ == "__main__":
    main()

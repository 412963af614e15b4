"""Tables of two checkouts: write, open, find, filter and list clips, NOW divided by BASE.

    python benchmarks/tables.py BASE NOW [--clips 1000 50000 1000000] [--rounds 5]

/clips has 19 columns, the same in both: texts, captions of 66 bytes on average, lists of texts and of numbers, whole
numbers that some clips do not have, rows of two fields; /windows has 11 windows a clip. Each checkout writes them
with its own writer and reads them with its own reader, every operation in a process of its own, imports done:

- write: the columns, from Python lists into the file; MB: that file
- open: the dataset, with frames, rows, windows and ids
- find: one clip by its id, the first that is looked for, with all its attributes
- genre ==: which clips have a genre
- ids, captions: all of them as a list of str

Rounds alternate between the checkouts and between who is first: 5, of a million clips 3. Medians are printed, of wall
and CPU milliseconds, and of the growth of the resident set (MB, from /proc/self/smaps_rollup). Files are in the page
cache. Ratios of times below 5 ms are noise of a few tenths of a millisecond.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from million import FRAMES, STRIDE, WINDOWS, lay_out, memory_mb, seal

GENRES = ("gBR", "gPO", "gLO", "gMH", "gLH", "gHO", "gWA", "gKR", "gJS", "gJB")
WORDS = (
    "a", "dancer", "turns", "slowly", "to", "the", "side", "and", "steps", "in", "with", "both", "arms", "raised",
    "above", "her",
)  # fmt: skip
OPERATIONS = ("write", "open", "find", "genre ==", "ids", "captions")
MANY = 1_000_000


def columns(n: int, missing: Mapping[str, Any]) -> dict[str, tuple[str, Sequence[Any]]]:
    """Return the columns of n clips by name, with their kinds; `missing` has what stands for no value."""
    rows, rng = range(n), np.random.default_rng(0)
    captions = [" ".join(WORDS[k] for k in picks) for picks in rng.integers(len(WORDS), size=(4096, 13)).tolist()]
    levels = [missing["int"], *range(6)]
    return {
        "id": ("text", [f"clip{k:07d}" for k in rows]),
        "genre": ("text", [GENRES[k % 10] for k in rows]),
        "music": ("text", [f"m{GENRES[k % 10]}{k // 10:06d}" for k in rows]),
        "dancer": ("text", [f"d{k % 40:02d}" for k in rows]),
        "lists": ("texts", [("cross_genre.train", "clean")[: k % 3] for k in rows]),
        "tempo_bpm": ("float", [80.0 + k % 50 for k in rows]),
        "height_m": ("float", [1.5 + k % 50 / 100 if k % 4 else float("nan") for k in rows]),
        "n_frames": ("int32", [FRAMES] * n),
        "n_flags": ("int32", [k % 4 for k in rows]),
        "trim_start": ("int32", [k % 30 for k in rows]),
        "x/caption": ("text", [captions[k % 4096] + "." * (k % 7) for k in rows]),
        "x/level": ("int", [levels[k % 7] for k in rows]),
        "x/tags": ("texts", [("slow", "low", "floor")[: k % 4] for k in rows]),
        "x/weights": ("floats", [(0.25, 0.5, 1.0)[: k % 4] for k in rows]),
        "motion/pose/start": ("int", [k * FRAMES for k in rows]),
        "motion/pose/length": ("int32", [FRAMES] * n),
        "audio/music/start": ("int", [k * FRAMES for k in rows]),
        "audio/music/length": ("int32", [FRAMES] * n),
        "audio/music/offset": ("int", [0] * n),
    }


def has_format_2() -> bool:
    """Return whether this checkout is of before format 3, with tables a split and texts as offsets and bytes."""
    return importlib.util.find_spec("dancedata.store.table_columns") is not None


def write(folder: Path, n: int) -> Measured:
    """Write a dataset whose tables have n clips; measure its columns."""
    from dancedata.store import hdf5
    from dancedata.store.hdf5 import SparseFile

    is_format_2 = has_format_2()
    if is_format_2:
        from dancedata.store.table_columns import MISSING, TextColumn, type_of
    else:
        from dancedata.store.columns import MISSING, write_column
    info = lay_out(folder, n)
    values, name = columns(n, MISSING), "train-tables.h5" if is_format_2 else "tables.h5"
    clip = np.repeat(np.arange(n), WINDOWS).astype(np.int32)
    start = np.tile(np.arange(WINDOWS) * STRIDE, n).astype(np.int32)

    def run() -> None:
        layout = SparseFile()
        with hdf5.create_file(layout) as file:
            if is_format_2:
                for column, (kind, cells) in values.items():
                    type_of(kind).write(file, f"clips/{column}", cells)
                by_id = TextColumn.of(values["id"][1]).sorted_rows()
                hdf5.write_array(file, "clips/by_id", by_id)
            else:
                hdf5.write_attributes(file, format=info["format"], fps=info["fps"])
                shard = {"split": "train", "file": info["shards"][0]["file"]}
                for column, (kind, cells) in (values | {k: ("text", [v] * n) for k, v in shard.items()}).items():
                    write_column(file, f"clips/{column}", kind, cells, nullable=column == "x/level")
            hdf5.write_array(file, "windows/clip", clip)
            hdf5.write_array(file, "windows/start", start)
        with open(folder / name, "wb") as target:
            layout.copy_to(target)

    measured = measure(run)
    if is_format_2:
        kinds = [{"name": column, "type": kind.removesuffix("32")} for column, (kind, _) in values.items()]
        info["tables"]["clips"]["columns"] = kinds
        info["splits"]["train"]["rows"] = {"clips": n, "windows": n * WINDOWS}
    seal(folder, info, name)
    return measured | {"file": (folder / name).stat().st_size / 1e6}


def read(folder: Path, n: int, operation: str) -> Measured:
    """Open a dataset, and measure an operation on it."""
    from dancedata.store.dataset import open_store

    is_format_2 = has_format_2()
    if is_format_2:
        from dancedata.readers.clip_values import _has as clips_with
    else:
        from dancedata.store.clip_choice import clips_with

    def opened() -> Any:
        store = open_store(folder)
        return store, store.tables("train") if is_format_2 else store._tables

    if operation == "open":
        return measure(opened)
    store, tables = opened()
    operations: dict[str, Callable[[], Any]] = {
        "find": lambda: store[f"clip{n // 2:07d}"],
        "genre ==": lambda: clips_with(tables, "genre", ("gBR",)),
        "ids": lambda: list(tables.ids),
        "captions": lambda: list(tables.columns["x/caption"]),
    }
    return measure(operations[operation])


Measured = dict[str, float]


def measure(run: Callable[[], Any]) -> Measured:
    """Return wall and CPU milliseconds, and by how many MB the resident set has grown with the result."""
    before, cpu, wall = memory_mb()[1], time.process_time(), time.perf_counter()
    result = run()
    spent = {"wall": (time.perf_counter() - wall) * 1e3, "cpu": (time.process_time() - cpu) * 1e3}
    spent["rss"] = memory_mb()[1] - before
    del result
    return spent


def main() -> None:
    """Print a row for each number of clips and operation."""
    from ratios import ROUNDS, environment, print_machine

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", type=Path)
    parser.add_argument("now", type=Path)
    parser.add_argument("--clips", type=int, nargs="+", default=[1000, 50_000, MANY])
    parser.add_argument("--rounds", type=int, help=f"default {ROUNDS}, of {MANY:,} clips 3")
    parser.add_argument("--work", type=Path, help="for the datasets, 0.5 GB each at a million")
    options = parser.parse_args()
    print(__doc__)
    print_machine()
    heads = ("wall ms", "CPU ms", "grown MB", "file MB")
    print(f"{'clips':>9} {'':9}" + "".join(f"{head:>9} base{'now':>9}{'ratio':>7}" for head in heads))
    for n in options.clips:
        rounds = options.rounds or (ROUNDS if n < MANY else 3)
        spent: dict[tuple[str, str], list[Measured]] = {}
        with tempfile.TemporaryDirectory(dir=options.work) as work:
            for turn in range(rounds):
                for operation in OPERATIONS:
                    for side in ("base", "now")[:: 1 if turn % 2 else -1]:
                        checkout = getattr(options, side).resolve()
                        if operation == "write":
                            shutil.rmtree(Path(work, side), ignore_errors=True)
                        words = [sys.executable, "-P", __file__, "--child", operation, Path(work, side), n]
                        output = subprocess.run(
                            list(map(str, words)), check=True, env=environment(checkout), cwd=checkout,
                            capture_output=True, text=True,
                        ).stdout  # fmt: skip
                        spent.setdefault((operation, side), []).append(json.loads(output))
        for operation in OPERATIONS:
            row, base, now = f"{n:9,} {operation:9}", *(spent[operation, side] for side in ("base", "now"))
            for what in base[0]:
                medians = [statistics.median(measured[what] for measured in of_side) for of_side in (base, now)]
                ratio = medians[1] / medians[0] if medians[0] else float("nan")
                row += f"{medians[0]:14.1f}{medians[1]:9.1f}{ratio:7.2f}"
            print(f"{row}  (load {os.getloadavg()[0]:.1f})", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        operation, folder, n = sys.argv[2], Path(sys.argv[3]), int(sys.argv[4])
        print(json.dumps(write(folder, n) if operation == "write" else read(folder, n, operation)))
    else:
        main()

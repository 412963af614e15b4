"""stats.json: statistics of the rows of train windows, per field and column, in bounded memory."""

import itertools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.codebook import Codebook
from dancedata.core.system import n_cores
from dancedata.store.column_stats import (
    QUANTILES,
    ColumnStats,
    CountedRows,
    Counts,
    Float32Array,
    Workspace,
    column_stats,
)
from dancedata.store.normalize import MinMax
from dancedata.store.schema import Field, StoreHeader
from dancedata.store.shard_plan import ShardPlan
from dancedata.store.shard_writer import SameColumns

#: Memory and the disk are shared: more threads do not write faster.
_MOST_THREADS = 4
#: Values (float32) of a block of columns in memory; a field with more rows is read in several passes.
_BLOCK_VALUES = 1 << 24
#: Most codes whose counts stats.json lists.
_MOST_COUNTS = 65_536
#: Handing columns of smaller blocks to threads takes longer than their statistics.
_THREADED_VALUES = 1 << 18


def n_threads() -> int:
    """Return the number of threads for work that runs outside the interpreter's lock: one per core, at most 4."""
    return min(_MOST_THREADS, n_cores())


def compute_stats(
    out: Path,
    header: StoreHeader,
    plans: Sequence[ShardPlan],
    same: Sequence[SameColumns] = (),
    *,
    block_values: int = _BLOCK_VALUES,
) -> dict[str, Any]:
    """Compute statistics over every row that a train window covers.

    In track scope each row counts once, even if several windows cover it or several shards hold its timeline.
    In window scope every window has its own rows, so n is windows x rows, as in EDGE.

    Parameters
    ----------
    same
        Equal columns by shard: rows that windows have in common are then read once. Changes no number.
    block_values
        Values held in memory at a time.

    Returns
    -------
    dict
        stats.json: per field n and, per column, mean, std (ddof 0), min, max, quantiles (linear interpolation) and
        EDGE's min-max scaler; of codes n, min, max and counts alone. Without train windows: no fields, and a note; an
        optional field that no train clip has is left out.
    """
    train = [p for p in plans if p.split == "train" and any(c.starts for c in p.clips)]
    result: dict[str, Any] = {
        "format": 1,
        "split": "train",
        "windows": sum(len(c.starts) for p in train for c in p.clips),
        "fields": {},
    }
    if not train:
        result["note"] = "there are no train windows, so there are no statistics and no scaler"
        return result
    shards = [overlap for overlap, plan in zip(same, plans, strict=False) if any(plan is p for p in train)]
    for f in header.fields:
        stats: list[ColumnStats] = []
        sources = _covered(out, header, f, train)
        if f.optional and not any(len(source.weights) for source in sources):
            continue
        if f.codebook is not None:
            result["fields"][f.name] = _code_summary(sources, f.codebook)
            continue
        for columns, once in _groups(f, shards):
            stats += _column_stats(_each_once(sources, train, f) if once else sources, columns, block_values)
        result["fields"][f.name] = _summary(sum(int(source.counts.sum()) for source in sources), stats)
    return result


def _code_summary(sources: Sequence[CountedRows], codebook: Codebook) -> dict[str, Any]:
    """Return the counts of the codes of each column; rows without a code do not count to min and max.

    In window scope a row counts as often as windows have it. Above 65,536 codes their counts are left out.
    """
    n = sum(int(source.counts.sum()) for source in sources)
    counts = [np.zeros(size, dtype=np.int64) for size in codebook.sizes]
    for source in sources:
        for rows, weights in source.rows():
            for level, size in enumerate(codebook.sizes):
                column = rows[:, level].astype(np.int64)
                coded = column != codebook.pad
                counts[level] += np.bincount(column[coded], weights[coded], minlength=size).astype(np.int64)
    used = [np.flatnonzero(level) for level in counts]
    summary: dict[str, Any] = {
        "n": n,
        "min": [int(codes[0]) if len(codes) else codebook.pad for codes in used],
        "max": [int(codes[-1]) if len(codes) else codebook.pad for codes in used],
    }
    return summary | ({"counts": [c.tolist() for c in counts]} if sum(codebook.sizes) <= _MOST_COUNTS else {})


def _groups(f: Field, same: Sequence[SameColumns]) -> Iterator[tuple[slice, bool]]:
    """Split the columns of a field into those whose rows the windows of all shards have in common, and others."""
    flags = np.zeros(f.columns.width, dtype=np.bool_)
    if all(f.name in shard for shard in same) and same:
        flags = np.logical_and.reduce([shard[f.name] for shard in same])
    edges = [0, *(np.flatnonzero(np.diff(flags)) + 1).tolist(), len(flags)]
    for begin, end in pairwise(edges):
        yield slice(begin, end), bool(flags[begin])


def _each_once(sources: Sequence[CountedRows], train: Sequence[ShardPlan], f: Field) -> list[CountedRows]:
    """Return the same rows, where windows have them in common: each once, with the number of its windows."""
    counted = []
    for source, plan in zip(sources, train, strict=True):
        length = plan.header.grid.rows(plan.header.length, of=f.grid)
        starts = [plan.first_rows(f, number) for number in range(len(plan.clips))]
        once_by_starts = {begins.tobytes(): rows_once(begins, length).reshape(-1) for begins in starts}
        counted.append(
            replace(source, counts=np.concatenate([once_by_starts[begins.tobytes()] for begins in starts]))
        )
    return counted


def rows_once(starts: npt.NDArray[np.int64], length: int) -> Counts:
    """Count the windows that cover each row, (W, L) int32, at the first window that does; 0 at the others.

    `starts` (W,) are the rows at which the windows of a clip begin, ascending; `length` is the number of rows L.
    """
    numbers = np.arange(len(starts))[:, None]
    rows = starts[:, None] + np.arange(length)
    first_new = np.r_[starts[:1], starts[:-1] + length][:, None]
    counts = np.where(rows >= first_new, np.searchsorted(starts, rows, "right") - numbers, 0)
    return counts.astype(np.int32)


def _covered(out: Path, header: StoreHeader, f: Field, train: Sequence[ShardPlan]) -> list[CountedRows]:
    """Return the rows of the train shards and their counts; a timeline of several shards counts in the first."""
    length = header.grid.rows(header.length, of=f.grid)
    first_shard: dict[str, tuple[Counts, int]] = {}
    counted: list[Counts] = []
    for plan in train:
        windows = plan.window_table()
        starts = windows.rows[f.name]
        if f.optional:
            starts = starts[np.array([span.length > 0 for span in plan.motion[f.name]])[windows.clip]]
        edges = np.zeros(plan.rows[f.name] + 1, dtype=np.int64)
        np.add.at(edges, starts, 1)
        np.add.at(edges, starts + length, -1)
        counts = np.cumsum(edges[:-1], dtype=np.int32)
        if header.scope == "track":
            counts = np.minimum(counts, 1)
            if f.kind == "audio":
                _count_in_first_shard(plan, f.name, counts, first_shard)
        counted.append(counts)
    return [CountedRows.of(out / plan.file, f.path, counts) for plan, counts in zip(train, counted, strict=True)]


def _count_in_first_shard(
    plan: ShardPlan, name: str, counts: Counts, first_shard: dict[str, tuple[Counts, int]]
) -> None:
    for key, (start, array) in plan.blocks[name].items():
        n = array.shape[0]
        n_rows = counts[start : start + n]
        if key not in first_shard:
            first_shard[key] = (counts, start)
            continue
        home, home_start = first_shard[key]
        np.maximum(home[home_start : home_start + n], n_rows, out=home[home_start : home_start + n])
        n_rows[:] = 0


def _column_stats(sources: Sequence[CountedRows], columns: slice, block_values: int) -> list[ColumnStats]:
    """Read some columns of a field, as many at a time as fit into a block, and return the statistics of each."""
    each = [source.weights for source in sources]
    weights = np.concatenate(each)
    of_rows = None if (weights == 1).all() else weights
    firsts = [0, *itertools.accumulate(map(len, each))]
    step = max(1, block_values // len(weights))
    block = np.empty((min(step, columns.stop - columns.start), len(weights)), dtype=np.float32)
    threaded = block.size >= _THREADED_VALUES
    spaces = [Workspace(of_rows) for _ in range(min(n_threads(), len(block)) if threaded else 1)]

    def of_column(column: Float32Array) -> ColumnStats:
        space = spaces.pop()
        try:
            return column_stats(column, space)
        finally:
            spaces.append(space)

    stats: list[ColumnStats] = []
    with ExitStack() as stack:
        threads = ThreadPoolExecutor(len(spaces), thread_name_prefix="statistics") if threaded else None
        each_of = map if threads is None else stack.enter_context(threads).map
        for begin in range(columns.start, columns.stop, step):
            block_columns = slice(begin, min(begin + step, columns.stop))
            parts = [
                block[: block_columns.stop - block_columns.start, first:last] for first, last in pairwise(firsts)
            ]
            list(each_of(CountedRows.read_into, sources, itertools.repeat(block_columns), parts))
            stats += each_of(of_column, block[: block_columns.stop - block_columns.start])
    return stats


def _summary(n: int, stats: Sequence[ColumnStats]) -> dict[str, Any]:
    summary = {name: [getattr(column, name) for column in stats] for name in ("mean", "std", "min", "max")}
    quantiles = {str(q): [column.quantiles[k] for column in stats] for k, q in enumerate(QUANTILES)}
    scaler = MinMax(*(np.asarray(summary[k], dtype=np.float32) for k in ("min", "max")))
    names = ("data_min", "data_max", "data_range", "scale", "offset")
    scaler_values = {name: getattr(scaler, name).tolist() for name in names}
    return {"n": n, **summary, "quantiles": quantiles, "scaler": scaler_values}

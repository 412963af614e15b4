"""stats.json: statistics of the rows that train windows cover, per field and column, in one pass over the shards."""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dancedata.core.codebook import Codebook
from dancedata.store.normalize import Scaler
from dancedata.store.schema import Field, StoreHeader
from dancedata.store.shard_plan import ShardPlan
from dancedata.store.window_list import IntArray

#: Most codes whose counts stats.json lists.
_MOST_COUNTS = 65_536
#: Rows of a clip that are read at a time.
_ROWS = 1 << 12


class Block(NamedTuple):
    """Rows of a clip, or of a timeline that clips share: number of their shard, first row, how often each counts."""

    shard: int
    first: int
    counts: IntArray


#: Rows of a clip or timeline in a shard: its key, first row, number of rows.
KeyedRows = tuple[Hashable, int, int]
#: Rows of a field in a shard: first rows of its windows (W,), number of rows, its clips or timelines.
ShardRows = tuple[IntArray, int, Iterable[KeyedRows]]
#: Reads rows of a shard: its number, first row, number of rows.
ReadRows = Callable[[int, int, int], npt.NDArray[Any]]


def covered(shards: Iterable[ShardRows], length: int) -> list[Block]:
    """Return the rows that windows of `length` rows cover, each once; those of one key in its first shard."""
    found: dict[Hashable, Block] = {}
    for number, (starts, n_rows, keyed) in enumerate(shards):
        begun, ended = (np.bincount(rows, minlength=n_rows + 1) for rows in (starts, starts + length))
        counts = np.cumsum(begun - ended)
        for key, first, n in keyed:
            block = found.setdefault(key, Block(number, first, np.zeros(n, dtype=np.int64)))
            np.add(block.counts, counts[first : first + n], out=block.counts)
    return [block._replace(counts=np.minimum(block.counts, 1)) for block in found.values()]


def compute_stats(out: Path, header: StoreHeader, plans: Sequence[ShardPlan]) -> dict[str, Any]:
    """Return stats.json: statistics over every row that a train window covers, of shards that were written."""
    train = [p for p in plans if p.split == "train" and any(c.starts for c in p.clips)]
    n_windows = sum(len(c.starts) for p in train for c in p.clips)
    result: dict[str, Any] = {"format": 1, "split": "train", "windows": n_windows, "fields": {}}
    if not train:
        result["note"] = "there are no train windows, so there are no statistics and no scaler"
    for f in header.fields if train else ():
        length, shards = header.grid.rows(header.length, of=f.grid), (_windows_and_rows(plan, f) for plan in train)
        numbers = row_stats(f, repeated(covered(shards, length), partial(_read, out, train, f)))
        result["fields"] |= {f.name: numbers} if numbers else {}
    return result


def row_stats(f: Field, rows: Iterable[npt.NDArray[Any]]) -> dict[str, Any]:
    """Return the entry of a field by blocks of its rows (n, D), n > 0; empty without any."""
    return _column_stats(rows, f.columns.width) if f.codebook is None else _code_stats(rows, f.codebook)


def _read(out: Path, plans: Sequence[ShardPlan], f: Field, shard: int, first: int, n: int) -> npt.NDArray[Any]:
    offset = plans[shard].first_bytes[f.name] + first * f.row_bytes
    return np.fromfile(out / plans[shard].file, f.disk_dtype, n * f.columns.width, offset=offset).reshape(n, -1)


def _windows_and_rows(plan: ShardPlan, f: Field) -> ShardRows:
    starts, n_rows = plan.window_rows(f), plan.rows[f.name]
    if not f.per_clip:
        return starts, n_rows, [(key, first, array.shape[0]) for key, (first, array) in plan.blocks[f.name].items()]
    spans = plan.spans[f.name]
    has_rows = np.array([span.length > 0 for span in spans])
    keyed: list[KeyedRows] = [
        (clip.id, span.start, span.length) for clip, span in zip(plan.clips, spans, strict=True)
    ]
    return starts[has_rows[plan.windows[0]]], n_rows, keyed


def repeated(blocks: Sequence[Block], read: ReadRows) -> Iterator[npt.NDArray[Any]]:
    """Yield rows (n, D), n > 0, each as often as it counts: those of a clip alone, at most _ROWS stored ones."""
    for block in blocks:
        for begin in range(0, len(block.counts), _ROWS):
            counts = block.counts[begin : begin + _ROWS]
            if counts.any():
                rows = read(block.shard, block.first + begin, len(counts))
                yield rows if (counts == 1).all() else np.repeat(rows, counts, axis=0)


def _column_stats(blocks: Iterable[npt.NDArray[Any]], width: int) -> dict[str, Any]:
    """Return the numbers of each column.

    Means and squared deviations of blocks are merged as in Chan, Golub, LeVeque, "Algorithms for Computing the Sample
    Variance" (The American Statistician 37, 1983), in float64 and without BLAS, whose sums depend on the processor.
    """
    n, mean, squares = 0, np.zeros(width), np.zeros(width)
    low, high = np.full(width, np.inf), np.full(width, -np.inf)
    for rows in blocks:
        low, high = np.minimum(low, rows.min(axis=0)), np.maximum(high, rows.max(axis=0))
        values, total = rows.astype(np.float64), n + len(rows)
        mean_here = values.sum(axis=0) / len(rows)
        values -= mean_here
        apart = mean_here - mean
        squares += np.square(values, out=values).sum(axis=0) + np.square(apart) * (n * len(rows) / total)
        mean += apart * (len(rows) / total)
        n = total
        del values  # before the next ones are made
    if not n:
        return {}
    low, high = low + 0.0, high + 0.0  # -0.0 and 0.0 are equal, and either may be found
    constant = low == high
    scaler = Scaler("minmax", low.astype(np.float32), high.astype(np.float32))
    names = ("data_min", "data_max", "data_range", "scale", "offset")
    return {
        "n": n,
        "mean": np.where(constant, low, mean).tolist(),
        "std": np.where(constant, 0.0, np.sqrt(squares / n)).tolist(),
        "min": low.tolist(),
        "max": high.tolist(),
        "scaler": {name: getattr(scaler, name).tolist() for name in names},
    }


def _code_stats(blocks: Iterable[npt.NDArray[Any]], codebook: Codebook) -> dict[str, Any]:
    """Return the counts of the codes of each column; rows without a code do not count to min and max."""
    n, counts = 0, [np.zeros(size, dtype=np.int64) for size in codebook.sizes]
    for rows in blocks:
        n += len(rows)
        for level, size in enumerate(codebook.sizes):
            codes = rows[rows[:, level] != codebook.pad, level]
            counts[level] += np.bincount(codes, minlength=size)
    if not n:
        return {}
    used = [np.flatnonzero(level) for level in counts]
    summary: dict[str, Any] = {
        "n": n,
        "min": [int(codes[0]) if len(codes) else codebook.pad for codes in used],
        "max": [int(codes[-1]) if len(codes) else codebook.pad for codes in used],
    }
    return summary | ({"counts": [c.tolist() for c in counts]} if sum(codebook.sizes) <= _MOST_COUNTS else {})

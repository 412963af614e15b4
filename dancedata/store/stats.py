"""stats.json: statistics of the rows of train windows, per field and column, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.normalize import MinMax
from dancedata.store import hdf5
from dancedata.store.schema import Field, StoreHeader
from dancedata.store.shard_plan import ShardPlan

QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
#: Values (float32) of a block of columns in memory; a field with more rows is read in several passes.
_BLOCK_VALUES = 1 << 25
#: Values read from the file at a time.
_CHUNK_VALUES = 1 << 21

Counts = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Rows:
    """Rows of a dataset in a shard, and how many times each of them counts."""

    path: Path
    dataset: str
    counts: Counts


def compute_stats(
    out: Path, header: StoreHeader, plans: Sequence[ShardPlan], *, block_values: int = _BLOCK_VALUES
) -> dict[str, Any]:
    """Compute statistics over every row that a train window covers.

    In track scope each row counts once, even if several windows cover it or several shards hold its timeline.
    In window scope every window has rows of its own, so n is windows x rows, as in EDGE.

    Parameters
    ----------
    out
        Folder with the shards, written.
    header, plans
        Of the store.
    block_values
        Values held in memory at a time.

    Returns
    -------
    dict
        stats.json: per field n and, per column, mean, std (ddof 0), min, max, quantiles (linear
        interpolation) and EDGE's min-max scaler. Without train windows: no fields, and a
        note.
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
    for f in header.fields:
        sources = list(_covered(out, header, f, train))
        result["fields"][f.name] = _field_stats(f, sources, block_values)
    return result


def _covered(out: Path, header: StoreHeader, f: Field, train: Sequence[ShardPlan]) -> Iterator[_Rows]:
    """Yield the rows of the train shards and their counts; a timeline of several shards counts in the first."""
    length = header.grid.rows(header.length, of=f.grid)
    first_shard: dict[str, tuple[Counts, int]] = {}
    found: list[_Rows] = []
    for plan in train:
        starts = plan.window_table().rows[f.name]
        edges = np.zeros(plan.rows[f.name] + 1, dtype=np.int64)
        np.add.at(edges, starts, 1)
        np.add.at(edges, starts + length, -1)
        counts = np.cumsum(edges[:-1])
        if header.scope == "track":
            counts = np.minimum(counts, 1)
            if f.kind == "audio":
                _count_in_first_shard(plan, f.name, counts, first_shard)
        found.append(_Rows(out / plan.file, f.path, counts))
    yield from found


def _count_in_first_shard(
    plan: ShardPlan, name: str, counts: Counts, first_shard: dict[str, tuple[Counts, int]]
) -> None:
    for key, (start, array) in plan.blocks[name].items():
        n = array.shape[0]
        here = counts[start : start + n]
        if key not in first_shard:
            first_shard[key] = (counts, start)
            continue
        home, home_start = first_shard[key]
        np.maximum(home[home_start : home_start + n], here, out=home[home_start : home_start + n])
        here[:] = 0


def _field_stats(f: Field, sources: Sequence[_Rows], block_values: int) -> dict[str, Any]:
    n = int(sum(int(s.counts.sum()) for s in sources))
    width = f.columns.width
    step = max(1, min(width, block_values // n))
    summary: dict[str, list[Any]] = {k: [] for k in ("mean", "std", "min", "max")}
    quantiles: dict[str, list[float]] = {str(q): [] for q in QUANTILES}
    for begin in range(0, width, step):
        block = _read_columns(sources, n, slice(begin, min(begin + step, width)))
        # Sorted columns make every number below independent of the order in which rows were stored.
        block.sort(axis=1)
        for column in block:
            _add_column(column, summary, quantiles)
        # Otherwise two blocks would be in memory while the next one is read.
        del block, column
    minimum, maximum = (np.asarray(summary[k], dtype=np.float32) for k in ("min", "max"))
    return {"n": n, **summary, "quantiles": quantiles, "scaler": _scaler(minimum, maximum)}


def _read_columns(sources: Sequence[_Rows], n: int, columns: slice) -> npt.NDArray[np.float32]:
    """Read some columns of all counted rows, (columns, n), in runs of whole rows."""
    block = np.empty((columns.stop - columns.start, n), dtype=np.float32)
    filled = 0
    for source in sources:
        with hdf5.open_file(source.path) as file:
            dataset = file[source.dataset]
            step = max(1, _CHUNK_VALUES // dataset.shape[1])
            for begin in range(0, len(source.counts), step):
                counts = source.counts[begin : begin + step]
                total = int(counts.sum())
                if total:
                    rows = dataset[begin : begin + len(counts)][:, columns]
                    block[:, filled : filled + total] = np.repeat(rows, counts, axis=0).T
                    filled += total
    # Turns -0.0 into 0.0: the two are equal, so a sort may put either one first.
    block += np.float32(0)
    return block


def _add_column(
    column: npt.NDArray[np.float32], summary: dict[str, list[Any]], quantiles: dict[str, list[float]]
) -> None:
    values = column.astype(np.float64)
    low, high = float(values[0]), float(values[-1])
    mean = low if low == high else float(values.mean())
    difference = values - mean
    summary["mean"].append(mean)
    summary["std"].append(float(np.sqrt(np.mean(difference * difference))))
    summary["min"].append(low)
    summary["max"].append(high)
    for q in QUANTILES:
        position = q * (len(values) - 1)
        below = int(position)
        above = min(below + 1, len(values) - 1)
        between = values[below] + (values[above] - values[below]) * (position - below)
        quantiles[str(q)].append(float(between))


def _scaler(minimum: npt.NDArray[np.float32], maximum: npt.NDArray[np.float32]) -> dict[str, list[float]]:
    scaler = MinMax(minimum, maximum)
    values = {
        "data_min": scaler.data_min,
        "data_max": scaler.data_max,
        "data_range": scaler.data_range,
        "scale": scaler.scale,
        "offset": scaler.offset,
    }
    return {name: [float(v) for v in np.asarray(array)] for name, array in values.items()}

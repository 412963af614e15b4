"""Ranges of columns over the rows that train windows cover: the bounds and means of stats.json, and quantiles."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dancedata.kernel import Field, Store
from dancedata.pages.document import ColumnRange
from dancedata.store.stats import Block, covered, train_rows

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
#: Values in memory at a time, and rows that are read at a time.
_VALUES, _ROWS = 1 << 24, 1 << 14


def column_ranges(store: Store, name: str) -> tuple[ColumnRange, ...]:
    """Return the range of each column of a field; quantiles by linear interpolation.

    Empty for codes, and if no train window has rows of the field.
    """
    f, stats = store.field(name), store.stats["fields"].get(name)
    if stats is None or f.codebook is not None:
        return ()
    length = store.grid.rows(store.info["windows"]["length"], of=f.grid)
    blocks = covered(train_rows(store, f), length)
    step = max(1, _VALUES // stats["n"])
    quantiles = [
        np.quantile(_columns(store, f, blocks, slice(left, left + step)), _QUANTILES, axis=0, overwrite_input=True)
        for left in range(0, f.columns.width, step)
    ]
    rows = zip(
        f.columns.labels, stats["min"], *np.concatenate(quantiles, axis=1).tolist(), stats["max"], stats["mean"],
        strict=True,
    )  # fmt: skip
    return tuple(ColumnRange(label, *map(float, numbers)) for label, *numbers in rows)


def _columns(store: Store, f: Field, blocks: Sequence[Block], columns: slice) -> npt.NDArray[np.float64]:
    """Read some columns of the rows that count, each as often as it does."""
    readers, parts = store._shards("train"), []
    for shard, first, counts in blocks:
        for begin in range(0, len(counts), _ROWS):
            times = counts[begin : begin + _ROWS]
            if times.any():
                rows = readers[shard].rows(f.name, first + begin, len(times))
                parts.append(np.repeat(rows[:, columns], times, axis=0))
    return np.concatenate(parts) + np.float64(0)  # turns -0.0 into 0.0

"""The rows that train windows of an open store cover: which they are, and quantiles over them."""

from collections.abc import Iterator, Sequence
from hashlib import sha256
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from dancedata.store.row_queries import RowQueries
from dancedata.store.schema import Field
from dancedata.store.stats import KeyedRows, ShardRows, covered, repeated

#: Values in memory at a time.
_VALUES = 1 << 24


def train_masks(store: RowQueries, f: Field) -> Iterator[tuple[int, npt.NDArray[np.bool_]]]:
    """Yield the numbers of the shards of train, and which of their rows of a field windows cover."""
    length, splits = store.grid.rows(store._tables.window_length, of=f.grid), store._description.splits
    for number, (starts, n_rows, _) in enumerate(train_rows(store, f, hashed=False) if "train" in splits else ()):
        [block] = covered([(starts, n_rows, [(number, 0, n_rows)])], length)
        yield splits["train"].shards.start + number, block.counts > 0


def train_quantiles(store: RowQueries, f: Field, q: Sequence[float]) -> npt.NDArray[np.float64]:
    """Return quantiles of the columns of a field over its `train_rows`, (len(q), D), by linear interpolation."""
    readers, length = store._shards("train"), store.grid.rows(store._tables.window_length, of=f.grid)
    blocks = covered(train_rows(store, f), length)
    step = max(1, _VALUES // max(1, sum(int(block.counts.sum()) for block in blocks)))
    parts = []
    for left in range(0, f.columns.width, step):
        rows = repeated(blocks, lambda k, first, n: readers[k].rows(f.name, first, n))
        values = np.concatenate([part[:, left : left + step] for part in rows]) + np.float64(0)  # no -0.0
        parts.append(np.quantile(values, q, axis=0, overwrite_input=True))
    return np.concatenate(parts, axis=1)


def train_rows(store: RowQueries, f: Field, *, hashed: bool = True) -> Iterator[ShardRows]:
    """Yield the shards of train for `covered`; with `hashed`, equal timelines of several shards have the same key."""
    tables, train = store._tables, store._rows_of_split("train")
    has_rows = tables.has_rows(f)[tables.window_clip[train.windows]]
    clips = tables.window_clip[train.windows][has_rows]
    starts = tables.rows_of(f, store.grid)[train.windows][has_rows]
    spans = tables.spans[f.name]
    timelines = None if spans.offset is None else spans.first - spans.offset
    of_shard, clip_shard = (tables.shard_of(k) - train.shards.start for k in (clips, np.arange(tables.n_clips)))
    for number, reader in enumerate(store._shards("train")):
        n_rows = reader.layout(f.name).n_rows
        keyed: list[KeyedRows] = [(number, 0, n_rows)]
        if timelines is not None and hashed:
            begins = np.unique(timelines[clip_shard == number]).tolist()
            keyed = [
                (sha256(reader.rows(f.name, first, end - first).tobytes()).digest(), first, end - first)
                for first, end in pairwise([*begins, n_rows])
            ]
        yield starts[of_shard == number], n_rows, keyed

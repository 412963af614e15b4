"""Free columns and layers of segments in numbers: for `info`, reports and cards."""

from collections import Counter
from collections.abc import Iterable, Iterator
from statistics import median
from typing import Any

import numpy as np

from dancedata.core.clip import FreeColumn
from dancedata.core.segments import LayerNumbers
from dancedata.store.clip_columns import FREE, ClipRecord
from dancedata.store.row_queries import RowQueries
from dancedata.store.window_list import IntArray

#: Most values of a column, and labels of a layer, that are listed.
_VALUES = 12


def free_columns(store: RowQueries, clips: Iterable[ClipRecord]) -> tuple[FreeColumn, ...]:
    """Return the free columns of a dataset, by name."""
    types = store._tables.types
    of_clips = [clip for clip in clips if not clip.source] if types else []
    return tuple(_column(name, kind, of_clips) for name, kind in sorted(types.items()))


def _column(name: str, kind: str, clips: list[ClipRecord]) -> FreeColumn:
    key = name.removeprefix(FREE)
    held = [clip.columns[key] for clip in clips if key in clip.columns]
    entries = [entry for value in held for entry in _entries(value)]
    if kind in ("int", "float", "ints", "floats"):
        numbers = [float(entry) for entry in entries]
        least, middle, most = (f(numbers) if numbers else None for f in (min, median, max))
        return FreeColumn(name, kind, len(held), len(clips), least, middle, most, {}, len(set(entries)))
    counts = Counter(str(entry).lower() if kind == "bool" else entry for entry in entries)
    return FreeColumn(name, kind, len(held), len(clips), None, None, None, _most_frequent(counts), len(counts))


def _entries(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple):
        yield from dict.fromkeys(value)
    else:
        yield value


def _most_frequent(counts: Counter[str]) -> dict[str, int]:
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0]))[:_VALUES])


def layer_numbers(store: RowQueries) -> tuple[LayerNumbers, ...]:
    """Return the numbers of every layer, in the order of `store.layers`, over clips that are not copies."""
    tables, table = store._tables, store._segment_table
    columns, source = {} if table is None else table.columns, tables.columns.get("source")
    original = np.ones(tables.n_clips, dtype=np.bool_) if source is None else source.isin([""])
    n_frames = int(np.asarray(tables.n_frames)[original].sum())
    clip, start, end, layer_of = (
        np.asarray(columns.get(name, ()), dtype=np.int64) for name in ("clip", "start", "end", "layer")
    )
    rows = [np.flatnonzero(original[clip] & (layer_of == number)) for number in range(len(store.layers))]
    numbers = []
    for layer, k in zip(store.layers, rows, strict=True):
        texts = [text for row in k.tolist() for text in columns["texts"][row]]
        labels = Counter(label for row in k.tolist() if (label := columns["label"][row]))
        numbers.append(
            LayerNumbers(
                layer.name, layer.kind, layer.language, layer.author, layer.licence, layer.sided,
                segments=len(k),
                clips=len(np.unique(clip[k])),
                median_s=float(np.median(end[k] - start[k]) / float(store.grid.rate)) if len(k) else None,
                coverage=_covered(clip[k], start[k], end[k]) / max(n_frames, 1),
                texts=len(texts),
                words=sum(len(text.split()) for text in texts),
                labels=_most_frequent(labels),
            )
        )  # fmt: skip
    return tuple(numbers)


def _covered(clip: IntArray, start: IntArray, end: IntArray) -> int:
    """Return how many frames at least one of the segments covers; they are sorted by clip and start."""
    if not len(clip):
        return 0
    # All clips on one axis, each far behind the one before.
    shift = clip * (int(end.max()) + 1)
    start, end = start + shift, end + shift
    before = np.concatenate([[start[0]], np.maximum.accumulate(end)[:-1]])
    return int(np.maximum(end - np.maximum(start, before), 0).sum())

"""Numbers of the layers of segments of a dataset: coverage, lengths, words."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dancedata.core.segments import LayerNumbers
from dancedata.store.segment_queries import SegmentQueries

_LABELS = 12
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Rows:
    """Segments of one layer: clips, numbered over all splits, frames, labels and texts."""

    clip: IntArray
    start: IntArray
    end: IntArray
    label: list[str]
    texts: list[tuple[str, ...]]


def layer_numbers(store: SegmentQueries) -> tuple[LayerNumbers, ...]:
    """Return the numbers of every layer, in the order of `store.layers`."""
    rows, n_frames = _rows(store)
    is_fact = [layer.name == "facts" for layer in store.layers]
    still: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for of_layer, fact in zip(rows, is_fact, strict=True):
        for k in range(len(of_layer.clip)) if fact else ():
            if of_layer.label[k] == "still":
                still[int(of_layer.clip[k])].append((int(of_layer.start[k]), int(of_layer.end[k])))
    numbers = []
    for layer, of_layer, fact in zip(store.layers, rows, is_fact, strict=True):
        lengths = of_layer.end - of_layer.start
        spans = (x.tolist() for x in (of_layer.clip, of_layer.start, of_layer.end))
        at_rest = sum(
            any(a <= start and end <= b for a, b in still.get(clip, ()))
            for clip, start, end in zip(*spans, strict=True)
        )
        texts = [text for texts in of_layer.texts for text in texts]
        labels = Counter(label for label in of_layer.label if label)
        numbers.append(
            LayerNumbers(
                layer.name, layer.kind, layer.language, layer.author, layer.licence, layer.sided,
                segments=len(lengths),
                clips=len(np.unique(of_layer.clip)),
                median_s=float(np.median(lengths) / float(store.grid.rate)) if len(lengths) else None,
                coverage=_covered(of_layer) / max(n_frames, 1),
                texts=len(texts),
                words=sum(len(text.split()) for text in texts),
                labels=dict(sorted(labels.items(), key=lambda entry: (-entry[1], entry[0]))[:_LABELS]),
                still=None if fact or not any(is_fact) else at_rest,
            )
        )  # fmt: skip
    return tuple(numbers)


def _rows(store: SegmentQueries) -> tuple[list[_Rows], int]:
    """Return the segments of each layer, of clips that are not copies, and the number of frames of these clips."""
    parts: list[list[tuple[int, int, int, str, tuple[str, ...]]]] = [[] for _ in store.layers]
    tables, table = store._tables, store._segment_table
    source = tables.columns.get("source")
    own = np.array([source is None or not source[row] for row in range(tables.n_clips)], dtype=np.bool_)
    n_frames = int(np.asarray(tables.n_frames)[own].sum())
    if table is not None:
        columns = table.columns
        for k in np.flatnonzero(own[np.asarray(columns["clip"])]).tolist():
            clip, start, end = (int(columns[name][k]) for name in ("clip", "start", "end"))
            parts[int(columns["layer"][k])].append((clip, start, end, columns["label"][k], columns["texts"][k]))
    return [_Rows(*_columns(part)) for part in parts], n_frames


def _columns(
    part: list[tuple[int, int, int, str, tuple[str, ...]]],
) -> tuple[IntArray, IntArray, IntArray, list[str], list[tuple[str, ...]]]:
    spans = np.array([row[:3] for row in part], dtype=np.int64).reshape(-1, 3)
    return spans[:, 0], spans[:, 1], spans[:, 2], [row[3] for row in part], [row[4] for row in part]


def _covered(rows: _Rows) -> int:
    """Return how many frames at least one of the segments covers; they are sorted by clip and start."""
    if not len(rows.clip):
        return 0
    # All clips on one axis, each far behind the one before.
    shift = rows.clip * (int(rows.end.max()) + 1)
    start, end = rows.start + shift, rows.end + shift
    before = np.concatenate([[start[0]], np.maximum.accumulate(end)[:-1]])
    return int(np.maximum(end - np.maximum(start, before), 0).sum())

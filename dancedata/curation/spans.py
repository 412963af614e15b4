"""Spans of frames with a fault, and the masks that they are made of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dancedata.core.rotations import Float64Array
from dancedata.core.tracks import runs

BoolArray = npt.NDArray[np.bool_]


class Span(NamedTuple):
    """Frames [start, end) of a motion with a fault; `joint` is "" for the whole body."""

    start: int
    end: int
    value: float
    joint: str = ""


def bridged(mask: BoolArray, longest: float) -> BoolArray:
    """Return the mask with gaps between true values of at most `longest` frames filled."""
    filled = mask.copy()
    for start, stop in runs(~mask):
        if start and stop < len(mask) and stop - start <= longest:
            filled[start:stop] = True
    return filled


def worst_spans(values: Float64Array, least: float, names: tuple[str, ...]) -> tuple[Span, ...]:
    """Return the spans of values (T, K) above `least`, each with its largest value and the name of that column."""
    if not values.size:
        return ()
    largest = values.max(axis=1)
    spans = []
    for start, stop in runs(largest > least):
        frame = start + int(np.argmax(largest[start:stop]))
        spans.append(Span(start, stop, float(largest[frame]), names[int(np.argmax(values[frame]))]))
    return tuple(spans)

"""Effect of the scaler of training on a field: its divisors, a sample at five sigma, columns that explode."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.kernel import Store

#: A smaller range in training, as a divisor, magnifies noise.
NARROW = 1e-3
#: Normalised values beyond this explode; training has -1 to 1.
EXPLODES = 10.0


@dataclass(frozen=True)
class ScaledGroup:
    """A group of columns and its scaler, EDGE's of the range in training."""

    group: str
    unit: str
    width: int
    # `min`, `max`: over train windows, in the group's unit
    min: float
    max: float
    std: float  # median over columns of the standard deviation
    # largest normalised value, without its sign, of a sample five standard deviations from the mean
    five_sigma: float
    largest: float | None  # the same of the rows of other splits; None without them
    narrow: tuple[str, ...]  # columns with a range below NARROW that is not 0
    exploding: tuple[tuple[str, float], ...]  # columns with rows of other splits beyond EXPLODES, and that value


def scaled_groups(store: Store, name: str) -> tuple[ScaledGroup, ...]:
    """Return the groups of a motion field; empty for other fields, codes, and without train windows."""
    field, stats = store.field(name), store.stats["fields"].get(name)
    if field.kind != "motion" or stats is None or field.codebook is not None:
        return ()
    scaler = store.scaler(name)
    mean, std = (np.asarray(stats[key], dtype=np.float64) for key in ("mean", "std"))
    low, high = (np.asarray(stats[key], dtype=np.float64) for key in ("min", "max"))
    sigma = np.abs(scaler.normalize(np.stack([mean - 5 * std, mean + 5 * std]))).max(axis=0)
    blocks = [np.abs(scaler.normalize(rows)).max(axis=0) for rows in _other_rows(store, name) if len(rows)]
    largest = np.max(blocks, axis=0) if blocks else None
    narrow = (high - low < NARROW) & (high > low)
    labels = field.columns.labels
    groups = []
    for group in field.columns.groups:
        span = field.columns.slice(group.name)
        columns = range(span.start, span.stop)
        exploding = [] if largest is None else [j for j in columns if largest[j] > EXPLODES]
        groups.append(
            ScaledGroup(
                group=group.name,
                unit=group.unit,
                width=group.width,
                min=float(low[span].min()),
                max=float(high[span].max()),
                std=float(np.median(std[span])),
                five_sigma=float(sigma[span].max()),
                largest=None if largest is None else float(largest[span].max()),
                narrow=tuple(labels[j] for j in columns if narrow[j]),
                exploding=tuple((labels[j], float(largest[j])) for j in exploding) if largest is not None else (),
            )
        )
    return tuple(groups)


def _other_rows(store: Store, name: str) -> Iterator[npt.NDArray[Any]]:
    """Yield the rows of all splits except train."""
    for split in store.splits:
        if split != "train":
            clips = (clip for clip in store if clip.split == split and not clip.source)
            yield from (clip.read(name) for clip in clips if (name in clip))

"""Counts in fine bins, which summarise a dataset of any size in constant memory, and histograms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

#: Steps of axes: these times a power of ten.
_STEPS = (1.0, 2.0, 2.5, 5.0)
#: Most bins of a histogram of values, and of one of a tally, which reaches up to a quantile.
_BINS, _FINE_BINS, _WITHIN = 24, 30, 0.995
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
#: Fewer values than this are named, not drawn.
_FEW = 3
#: Slack in units of a bin: rounding does not put a value on a border below it.
_SLACK = 1e-9


@dataclass
class BinCounts:
    """Values counted in bins of equal width; values outside count in the first or the last bin."""

    low: float  # lower end of the first bin
    width: float
    counts: IntArray
    total: float = 0.0  # sum of the values

    @classmethod
    def of(cls, low: float, high: float, width: float) -> BinCounts:
        """Make an empty one for values from `low` to `high`."""
        return cls(low, width, np.zeros(round((high - low) / width), dtype=np.int64))

    def add(self, values: npt.NDArray[Any]) -> None:
        """Count values (n,)."""
        numbers = np.asarray(values, dtype=np.float64).reshape(-1)
        bins = np.floor((numbers - self.low) / self.width + _SLACK).astype(np.int64)
        self.counts += np.bincount(bins.clip(0, len(self.counts) - 1), minlength=len(self.counts))
        self.total += float(numbers.sum())

    @property
    def n(self) -> int:
        """Number of values."""
        return int(self.counts.sum())

    @property
    def mean(self) -> float | None:
        """Mean of the values; None without values."""
        return self.total / self.n if self.n else None

    def quantile(self, q: float) -> float | None:
        """Return a quantile, exact to the width of a bin; None without values."""
        if not self.n:
            return None
        wanted = min(max(q * self.n, _SLACK), self.n)
        cumulated = np.cumsum(self.counts)
        place = int(np.searchsorted(cumulated, wanted, "left"))
        inside = (wanted - (cumulated[place] - self.counts[place])) / int(self.counts[place])
        return self.low + self.width * (place + float(np.clip(inside, 0, 1)))

    def share_above(self, limit: float) -> float | None:
        """Return the share of values in the bins from `limit` on; None without values."""
        first = round((limit - self.low) / self.width)
        return float(self.counts[first:].sum() / self.n) if self.n else None

    def histogram(self, edges: Sequence[float]) -> IntArray:
        """Return the counts between edges that are borders of bins; values outside are in the first or last one."""
        borders = [round((edge - self.low) / self.width) for edge in edges]
        borders[0], borders[-1] = 0, len(self.counts)
        sums = np.concatenate([[0], np.cumsum(self.counts)])
        return np.asarray(np.diff(sums[np.clip(borders, 0, len(self.counts))]), dtype=np.int64)


def nice_step(span: float, n: int) -> float:
    """Return the least round step that divides a span into at most `n` parts."""
    if not span > 0:
        return 1.0
    exact = span / n
    power = 10.0 ** np.floor(np.log10(exact))
    return float(next(s * power for s in (*_STEPS, 10.0) if s * power >= exact * (1 - _SLACK)))


def nice_edges(low: float, high: float, least: float = 0.0) -> tuple[float, ...]:
    """Return the borders of at most `_BINS` bins from `low` to `high`, `least` wide or wider."""
    if high - low <= _SLACK * max(1.0, abs(low)):  # a single value, in one bin with room around it
        step = least or nice_step(max(abs(low), 1.0), 10)
        first = int(np.floor(low / step + _SLACK)) - 2
        return tuple(round(k * step, 10) for k in range(first, first + 6))
    step = max(nice_step(high - low, _BINS), least)
    first = int(np.floor(low / step + _SLACK))
    last = max(int(np.ceil(high / step - _SLACK)), first + 1)
    return tuple(round(k * step, 10) for k in range(first, last + 1))


def fine_edges(tallies: Sequence[BinCounts], beyond: float | None = None) -> tuple[float, ...]:
    """Return borders of bins for tallies of equal bins, up to a high quantile of the widest of them."""
    low, width = tallies[0].low, tallies[0].width
    high = max((t.quantile(_WITHIN) or low + width for t in tallies), default=low + width)
    high = high if beyond is None else max(high, beyond + width)
    bins = max(1, int(np.ceil((high - low) / width - _SLACK)))
    group = next(g for p in range(8) for g in (10**p, 2 * 10**p, 5 * 10**p) if bins / g <= _FINE_BINS)
    last = int(np.ceil(bins / group))
    return tuple(round(low + width * group * k, 10) for k in range(last + 1))


@dataclass(frozen=True)
class FiveNumbers:
    """Least, quartiles, median and largest of values; None without values."""

    min: float | None
    p25: float | None
    p50: float | None
    p75: float | None
    max: float | None

    @classmethod
    def of(cls, values: Sequence[float]) -> FiveNumbers:
        """Summarise values."""
        return FiveNumbers(*_five(values))


@dataclass(frozen=True)
class Quantiles:
    """Quantiles of the values of a tally; None without values."""

    p5: float | None
    p25: float | None
    p50: float | None
    p75: float | None
    p95: float | None

    @classmethod
    def of_tally(cls, tally: BinCounts) -> Quantiles:
        """Summarise a tally."""
        return Quantiles(*map(tally.quantile, _QUANTILES))


@dataclass(frozen=True)
class Histogram:
    """Counts in bins, of one or several groups."""

    edges: tuple[float, ...]  # (B + 1,) borders
    counts: Mapping[str, list[int]]  # (B,) counts of each group
    n: int  # number of values
    # (B,) counts of each split; empty where `counts` has them
    by_split: Mapping[str, list[int]] = field(default_factory=dict, kw_only=True)


@dataclass(frozen=True)
class ClipHistogram(FiveNumbers, Histogram):
    """Histogram of one value per clip, with their five numbers."""

    # number of clips with each value, to a tenth of a bin, where there are at most two; values within one bin count
    # as their median
    distinct: tuple[tuple[float, int], ...] = field(default=(), kw_only=True)

    @classmethod
    def of_groups(cls, groups: Mapping[str, Sequence[float]], edges: Sequence[float], **more: Any) -> Self:
        """Count values; each is within the edges."""
        counts = counted_between(groups, edges)
        values = [v for values in groups.values() for v in values]
        distinct = _distinct(values, edges[1] - edges[0])
        return cls(tuple(edges), counts, len(values), *_five(values), distinct=distinct, **more)


def counted_between(groups: Mapping[str, Sequence[float]], edges: Sequence[float]) -> dict[str, list[int]]:
    """Return the counts of values between edges, by group; each value is within the edges."""
    return {name: np.histogram(np.asarray(v, np.float64), edges)[0].tolist() for name, v in groups.items()}


def _distinct(values: Sequence[float], step: float) -> tuple[tuple[float, int], ...]:
    if not values:
        return ()
    if max(values) - min(values) < step:
        return ((float(np.median(values)), len(values)),)
    counts = Counter(round(round(v / step * 10) * step / 10, 10) for v in values)
    return tuple(sorted(counts.items())) if len(counts) < _FEW else ()


@dataclass(frozen=True)
class FrameHistogram(Quantiles, Histogram):
    """Histogram of the values of a tally, with mean and quantiles; None without values."""

    mean: float | None

    @classmethod
    def of(cls, tally: BinCounts, edges: Sequence[float], **more: Any) -> Self:
        """Count the values of a tally in wider bins."""
        counts = {"all": tally.histogram(edges).tolist()}
        return cls(tuple(edges), counts, tally.n, **vars(Quantiles.of_tally(tally)), mean=tally.mean, **more)


def _five(values: Sequence[float]) -> Sequence[float | None]:
    if not len(values):
        return (None,) * 5
    numbers: list[float | None] = np.quantile(np.asarray(values), (0, 0.25, 0.5, 0.75, 1)).tolist()
    return numbers

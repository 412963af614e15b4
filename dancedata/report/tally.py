"""Counts of values in fine bins, so that a dataset of any size is summarised in constant memory; and histograms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.report.measure import SLIDE_M_S, ClipNumbers, Measured

#: Half the range of offsets, milliseconds; bins are one frame wide, as key motions lie between frames.
_OFFSET_MS = 400


@dataclass(frozen=True)
class Scales:
    """Borders of the bins of each histogram.

    Attributes
    ----------
    length_s, tempo_bpm, music_minus_motion_s
        Of clips.
    speed, sliding, offset_ms
        Of frames, and of key motions.
    root_extent_m, turns, floor_m
        Of clips.
    """

    length_s: tuple[float, ...]
    tempo_bpm: tuple[float, ...]
    music_minus_motion_s: tuple[float, ...]
    speed: tuple[float, ...]
    sliding: tuple[float, ...]
    offset_ms: tuple[float, ...]
    root_extent_m: tuple[float, ...]
    turns: tuple[float, ...]
    floor_m: tuple[float, ...]

    @classmethod
    def of(cls, datasets: Sequence[Measured]) -> Scales:
        """Choose borders that hold the values of all datasets."""
        clips = [(m, c) for m in datasets for c in m.store.clips if not c.source]
        numbers = [n for m in datasets for n in m.clips.values()]
        lengths = [float(m.store.grid.seconds(c.n_frames)) for m, c in clips]
        gaps = [gap for m in datasets for gap in music_gaps(m).values()]
        return cls(
            length_s=_of(lengths, 0.1),
            tempo_bpm=_of([c.tempo_bpm for _, c in clips if c.tempo_bpm is not None], 1),
            music_minus_motion_s=_of(gaps, 0.1),
            speed=fine_edges([m.speed for m in datasets]),
            sliding=fine_edges([m.sliding for m in datasets], beyond=SLIDE_M_S),
            offset_ms=_offsets(datasets),
            root_extent_m=_of(_values(numbers, lambda n: n.root_extent_m), 0.05, low=0.0),
            turns=_of(_values(numbers, lambda n: n.turns), 0.05, low=0.0),
            floor_m=_of(_values(numbers, lambda n: n.floor_m), 0.01),
        )


def music_gaps(found: Measured) -> dict[str, float]:
    """Return by how many seconds the music of each clip is longer than its motion, from the first frame on."""
    grid = found.store.grid
    return {
        c.id: music - float(grid.seconds(c.n_frames))
        for c in found.store.clips
        if not c.source and (music := found.clips[c.id].music_s) is not None
    }


def _values(numbers: Sequence[ClipNumbers], value: Callable[[ClipNumbers], Any]) -> list[float]:
    return [v for v in map(value, numbers) if v is not None]


def _of(values: Sequence[float], smallest: float, low: float | None = None) -> tuple[float, ...]:
    """Return borders from `low`, or the least value, in steps of `smallest` or more."""
    if not values:
        return (0.0, 1.0)
    first = min(values) if low is None else min(low, *values)
    return nice_edges(first, max(values), least=smallest)


def _offsets(datasets: Sequence[Measured]) -> tuple[float, ...]:
    """Return borders one frame apart, rounded to bins of the tally; key motions then lie in the middle of a bin."""
    rates = [float(m.reader.motion.rate) for m in datasets if m.reader.motion is not None]
    frame = 1000 / min(rates, default=30.0)
    frame *= max(1, round(_OFFSET_MS / 20 / frame))
    n = int(_OFFSET_MS // frame)
    return tuple(round(2 * k * frame) / 2 for k in range(-n, n + 1))


Float64Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

#: Steps of axes: these times a power of ten.
_STEPS = (1.0, 2.0, 2.5, 5.0)
#: Slack in units of a bin, so that a value on a border is not put below it by rounding.
_SLACK = 1e-9


@dataclass
class Tally:
    """Values counted in bins of equal width; what lies outside is counted in the first or the last bin.

    Attributes
    ----------
    low, width
        Lower end of the first bin, and the width of each.
    counts
        (B,) numbers of values.
    total
        Sum of the values.
    """

    low: float
    width: float
    counts: IntArray
    total: float = 0.0

    @classmethod
    def of(cls, low: float, high: float, width: float) -> Tally:
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


def nice_edges(low: float, high: float, n: int = 24, least: float = 0.0) -> tuple[float, ...]:
    """Return the borders of bins that hold everything from `low` to `high`.

    Parameters
    ----------
    n
        Bins, about and at most.
    least
        Smallest width of a bin.
    """
    if high - low <= _SLACK * max(1.0, abs(low)):  # a single value, with a bin of its own and some room
        step = least or nice_step(max(abs(low), 1.0), 10)
        first = int(np.floor(low / step + _SLACK)) - 2
        return tuple(round(k * step, 10) for k in range(first, first + 6))
    step = max(nice_step(high - low, n), least)
    first = int(np.floor(low / step + _SLACK))
    last = max(int(np.ceil(high / step - _SLACK)), first + 1)
    return tuple(round(k * step, 10) for k in range(first, last + 1))


def fine_edges(
    tallies: Sequence[Tally], n: int = 30, keep: float = 0.995, beyond: float | None = None
) -> tuple[float, ...]:
    """Return borders of bins for tallies of equal bins, up to the quantile `keep` of the widest of them.

    The last bin also counts what lies beyond it. The borders reach further than `beyond`, if it is given.
    """
    low, width = tallies[0].low, tallies[0].width
    high = max((t.quantile(keep) or low + width for t in tallies), default=low + width)
    high = high if beyond is None else max(high, beyond + width)
    bins = max(1, int(np.ceil((high - low) / width - _SLACK)))
    group = next(g for g in _groups() if bins / g <= n)
    last = int(np.ceil(bins / group))
    return tuple(round(low + width * group * k, 10) for k in range(last + 1))


def _groups() -> Any:
    return (int(s * 10**p) for p in range(8) for s in (1, 2, 5))


@dataclass(frozen=True)
class Histogram:
    """Counts in bins, of one or several groups.

    Attributes
    ----------
    edges
        (B + 1,) borders.
    counts
        (B,) counts of each group.
    numbers
        Further numbers, such as the median; None where there are no values.
    """

    edges: tuple[float, ...]
    counts: Mapping[str, Sequence[int]]
    numbers: Mapping[str, float | int | None] = field(default_factory=dict)

    @classmethod
    def of_values(cls, groups: Mapping[str, Sequence[float]], edges: Sequence[float]) -> Histogram:
        """Count single values; each is within the edges."""
        counts = {
            name: np.histogram(np.asarray(values, dtype=np.float64), edges)[0].tolist()
            for name, values in groups.items()
        }
        every = [v for values in groups.values() for v in values]
        middle = {"n": len(every), **five_numbers(every)}
        return cls(tuple(edges), counts, middle)

    @classmethod
    def of_tally(cls, tally: Tally, edges: Sequence[float]) -> Histogram:
        """Count the values of a tally."""
        quantiles = {f"p{round(100 * q)}": tally.quantile(q) for q in (0.05, 0.25, 0.5, 0.75, 0.95)}
        numbers = {"n": tally.n, "mean": tally.mean, **quantiles}
        return cls(tuple(edges), {"all": tally.histogram(edges).tolist()}, numbers)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        counts = {name: list(values) for name, values in self.counts.items()}
        return {"edges": list(self.edges), "counts": counts, **self.numbers}


def five_numbers(values: Sequence[float]) -> dict[str, float | None]:
    """Return min, p25, p50, p75 and max of values; None without values."""
    names = ("min", "p25", "p50", "p75", "max")
    if not len(values):
        return dict.fromkeys(names)
    return dict(zip(names, np.quantile(np.asarray(values), (0, 0.25, 0.5, 0.75, 1)).tolist(), strict=True))

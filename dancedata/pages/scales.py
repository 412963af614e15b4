"""Borders of the bins of a report's histograms: round, and the same for two datasets that are compared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dancedata.pages.bin_counts import fine_edges, nice_edges
from dancedata.pages.measure import SLIDE_M_S, ClipNumbers, Measured

#: Half the range of offsets, milliseconds; bins are one frame wide, as key motions lie between frames.
_OFFSET_MS = 400
#: A number of a clip; None where it was not measured.
ClipValue = Callable[[ClipNumbers], float | None]


def clip_values(measured: Measured, value: ClipValue) -> list[float]:
    """Return a number of all clips that have it."""
    return [v for v in map(value, measured.clips.values()) if v is not None]


@dataclass(frozen=True)
class Scales:
    """Borders of the bins of each histogram."""

    length_s: tuple[float, ...]
    tempo_bpm: tuple[float, ...]
    music_minus_motion_s: tuple[float, ...]
    speed: tuple[float, ...]
    sliding: tuple[float, ...]
    offset_ms: tuple[float, ...]
    root_extent_m: tuple[float, ...]
    turns: tuple[float, ...]
    floor_m: tuple[float, ...]
    distance_m: tuple[float, ...]

    @classmethod
    def of(cls, datasets: Sequence[Measured]) -> Scales:
        """Choose borders that hold the values of all datasets."""
        clips = [(m, c) for m in datasets for c in m.store.clips() if not c.source]

        def of_clips(value: ClipValue) -> list[float]:
            return [v for m in datasets for v in clip_values(m, value)]

        lengths = [float(m.store.grid.seconds(c.n_frames)) for m, c in clips]
        gaps = [gap for m in datasets for gap in music_gaps(m).values()]
        return cls(
            length_s=_borders(lengths, 0.1),
            tempo_bpm=_borders([c.tempo_bpm for _, c in clips if c.tempo_bpm is not None], 1),
            music_minus_motion_s=_borders(gaps, 0.1),
            speed=fine_edges([m.speed for m in datasets]),
            sliding=fine_edges([m.sliding for m in datasets], beyond=SLIDE_M_S),
            offset_ms=_offset_borders(datasets),
            root_extent_m=_borders(of_clips(lambda n: n.root_extent_m), 0.05, low=0.0),
            turns=_borders(of_clips(lambda n: n.turns), 0.05, low=0.0),
            floor_m=_borders(of_clips(lambda n: n.floor_m), 0.01),
            distance_m=fine_edges([m.groups.distance for m in datasets]),
        )


def music_gaps(measured: Measured) -> dict[str, float]:
    """Return by how many seconds the music of each clip is longer than its motion, from the first frame on."""
    grid = measured.store.grid
    return {
        c.id: music - float(grid.seconds(c.n_frames))
        for c in measured.store.clips()
        if not c.source and (music := measured.clips[c.id].music_s) is not None
    }


def _borders(values: Sequence[float], smallest: float, low: float | None = None) -> tuple[float, ...]:
    """Return borders from `low`, or the least value, in steps of `smallest` or more."""
    if not values:
        return (0.0, 1.0)
    first = min(values) if low is None else min(low, *values)
    return nice_edges(first, max(values), least=smallest)


def _offset_borders(datasets: Sequence[Measured]) -> tuple[float, ...]:
    """Return borders one frame apart, rounded to bins of the tally; key motions then lie in the middle of a bin."""
    rates = [float(m.reader.motion.rate) for m in datasets if m.reader.motion is not None]
    frame = 1000 / min(rates, default=30.0)
    frame *= max(1, round(_OFFSET_MS / 20 / frame))
    n = int(_OFFSET_MS // frame)
    return tuple(round(2 * k * frame) / 2 for k in range(-n, n + 1))

"""Beats of a signal, and rows with the phase in the bar at each instant."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dancedata.core.grid import FrameGrid

BEAT, DOWNBEAT, PHASE, TEMPO = range(4)
N_COLUMNS = 4
#: Phase where the bars are unknown.
UNKNOWN = -1.0
#: Beats of a bar where a signal has a single downbeat.
_USUAL_BAR = 4
#: Beats on each side of an interval that its tempo is measured over.
_TEMPO_REACH = 3

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BeatTrack:
    """The beats of a signal, and which of them begin a bar, (B,).

    `frames`: Frames of `grid`, ascending, each once; frame 0 is the first sample.
    """

    frames: npt.NDArray[np.int64]
    downbeats: npt.NDArray[np.bool_]
    grid: FrameGrid

    def rows(self, n_rows: int, grid: FrameGrid) -> npt.NDArray[np.float32]:
        """Return the rows (n_rows, 4) at the rate of `grid`: beat, downbeat, phase in the bar, tempo."""
        rows = np.zeros((n_rows, N_COLUMNS), dtype=np.float32)
        rows[:, PHASE] = UNKNOWN
        # A signal ends less than a row after its last row.
        nearest = np.minimum(self.grid.nearest_rows(self.frames, of=grid), n_rows - 1)
        rows[nearest, BEAT] = 1
        rows[nearest[self.downbeats], DOWNBEAT] = 1
        if len(self.frames) >= 2:
            seconds = self.frames / float(self.grid.rate)
            instants = np.arange(n_rows) / float(grid.rate)
            rows[:, TEMPO] = _tempos(seconds)[_intervals(seconds, instants)]
            if self.downbeats.any():
                rows[:, PHASE] = _phases(seconds, self.downbeats, instants)
        return rows


def _intervals(seconds: Floats, instants: Floats) -> npt.NDArray[np.int64]:
    """Return the interval between beats, 0 .. B - 2, that contains each instant or is nearest to it."""
    intervals: npt.NDArray[np.int64] = np.searchsorted(seconds, instants, side="right") - 1
    return intervals.clip(0, len(seconds) - 2)


def _tempos(seconds: Floats) -> Floats:
    """Return the tempo (B - 1,) at each interval between beats, in beats per minute.

    It is the mean over up to seven intervals, as one alone is known only to a frame. An interval of about k times
    the median counts as k beats, so that a beat that was missed does not change it.
    """
    lengths = np.diff(seconds)
    counts = np.concatenate([[0], np.cumsum(np.maximum(np.rint(lengths / np.median(lengths)), 1))])
    positions = np.arange(len(lengths))
    first, last = np.maximum(positions - _TEMPO_REACH, 0), np.minimum(positions + 1 + _TEMPO_REACH, len(lengths))
    tempos: Floats = 60 * (counts[last] - counts[first]) / (seconds[last] - seconds[first])
    return tempos


def _phases(seconds: Floats, downbeats: npt.NDArray[np.bool_], instants: Floats) -> npt.NDArray[np.float32]:
    """Return the share of the bar, [0, 1), that has passed at each instant: linear from beat to beat and beyond."""
    positions = bar_positions(downbeats)
    interval = _intervals(seconds, instants)
    begin, end = seconds[interval], seconds[interval + 1]
    part = (instants - begin) / (end - begin)
    at = positions[interval] + part * (positions[interval + 1] - positions[interval])
    # Rounded first: the instant of a downbeat must not be the end of the bar before.
    phases = (np.round(at, 6) % 1).astype(np.float32)
    return np.where(phases < 1, phases, np.float32(0))


def bar_positions(downbeats: npt.NDArray[np.bool_]) -> Floats:
    """Return the position (B,) of each beat in bars: whole numbers at downbeats, in steps of 1 / beats of the bar."""
    first = np.flatnonzero(downbeats)
    lengths = np.diff(first) if len(first) > 1 else np.array([_USUAL_BAR])
    bar = np.maximum(np.cumsum(downbeats) - 1, 0)
    of_bar = lengths[np.minimum(bar, len(lengths) - 1)]
    positions: Floats = bar + (np.arange(len(downbeats)) - first[bar]) / of_bar
    return positions

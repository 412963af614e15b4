"""Where dancers stand and face, and whether left and right move alike, over all clips of a dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dancedata.core.rotations import Float64Array
from dancedata.pages.bin_counts import nice_step

#: Half the side of the floor that is counted, and the side of a square of it, metres.
_REACH_M, _SQUARE_M = 20.0, 0.1
#: Most squares of the map from side to side.
_SQUARES = 28
#: Width of a direction, degrees; seconds that are counted, and most columns of the map.
FACING_DEG, _SECONDS, _COLUMNS = 15, 1800, 30


@dataclass(frozen=True)
class Balance:
    """Mean speed of a joint on the left and on the right, metres per second, and the share of the left."""

    left_m_s: float
    right_m_s: float
    left_share: float | None


@dataclass(frozen=True)
class StageNumbers:
    """Where dancers stand and face."""

    balance: Mapping[str, Balance]  # by joint without its side: "wrist"
    # `every_s`, `facing`: width of the columns, seconds, and frames by column and direction, of 15 degrees from -180
    # on; 0 is +Z, 90 is +X
    every_s: float
    facing: tuple[tuple[int, ...], ...]
    # `square_m`, `first_m`: side of the squares of the floor, metres, and the lower corner (x, z) of the first
    square_m: float
    first_m: tuple[float, float]
    # frames with the root in each square, by x, then z; only the part that holds all
    floor: tuple[tuple[int, ...], ...]
    beyond: int  # frames farther than 20 m from the origin


def _counts(*shape: int) -> npt.NDArray[np.int64]:
    return np.zeros(shape, np.int64)


@dataclass
class Stage:
    """Counts over the frames of all clips; their size does not depend on the number of frames."""

    speed: dict[str, float] = field(default_factory=dict)
    n: dict[str, int] = field(default_factory=dict)
    facing: npt.NDArray[np.int64] = field(default_factory=lambda: _counts(_SECONDS, 360 // FACING_DEG))
    floor: npt.NDArray[np.int64] = field(default_factory=lambda: _counts(*[round(2 * _REACH_M / _SQUARE_M)] * 2))
    beyond: int = 0

    def add(
        self,
        names: Sequence[str],
        speed: Float64Array,
        root: Float64Array,
        facing: Float64Array,
        seconds: Float64Array,
    ) -> None:
        """Count the frames of a piece."""
        for name, total in zip(names, speed.sum(axis=0).tolist(), strict=True):
            self.speed[name] = self.speed.get(name, 0.0) + total
            self.n[name] = self.n.get(name, 0) + len(speed)
        if len(facing):
            degrees = np.degrees(-facing)  # +X to +Z is a turn about -Y
            direction = np.floor((degrees + 180) % 360 / FACING_DEG + 1e-9).astype(int) % (360 // FACING_DEG)
            second = np.floor(seconds + 1e-9).astype(int)
            kept = second < _SECONDS
            np.add.at(self.facing, (second[kept], direction[kept]), 1)
        squares = np.floor((root[:, [0, 2]] + _REACH_M) / _SQUARE_M + 1e-6)
        inside = ((squares >= 0) & (squares < len(self.floor))).all(axis=1)
        np.add.at(self.floor, tuple(squares[inside].astype(int).T), 1)
        self.beyond += int((~inside).sum())

    def numbers(self) -> StageNumbers:
        """Return the counts in at most 30 columns of time, and 28 squares from side to side."""
        every, facing = _merged_time(self.facing)
        square, first, floor = _merged_floor(self.floor)
        return StageNumbers(self._balance(), every, _tuples(facing), square, first, _tuples(floor), self.beyond)

    def _balance(self) -> dict[str, Balance]:
        mean = {name: total / self.n[name] for name, total in self.speed.items() if self.n[name]}
        pairs = {}
        for name in mean:
            right = name.replace("left_", "right_", 1)
            if name.startswith("left_") and right in mean:
                both = mean[name] + mean[right]
                share = round(mean[name] / both, 4) if both else None
                pairs[name.removeprefix("left_")] = Balance(round(mean[name], 4), round(mean[right], 4), share)
        return pairs


def _tuples(counts: npt.NDArray[np.int64]) -> tuple[tuple[int, ...], ...]:
    return tuple(tuple(row) for row in counts.tolist())


def _merged_time(counts: npt.NDArray[np.int64]) -> tuple[float, npt.NDArray[np.int64]]:
    used = np.flatnonzero(counts.any(axis=1))
    if not len(used):
        return 1.0, counts[:0]
    every = max(1, round(nice_step(float(used[-1] + 1), _COLUMNS)))
    columns = -(-int(used[-1] + 1) // every)
    padded = np.zeros((columns * every, counts.shape[1]), np.int64)
    padded[: used[-1] + 1] = counts[: used[-1] + 1]
    return float(every), padded.reshape(columns, every, -1).sum(axis=1)


def _merged_floor(counts: npt.NDArray[np.int64]) -> tuple[float, tuple[float, float], npt.NDArray[np.int64]]:
    used = np.argwhere(counts)
    if not len(used):
        return _SQUARE_M, (0.0, 0.0), counts[:0, :0]
    low, high = used.min(axis=0), used.max(axis=0) + 1
    step = max(1, round(nice_step(float((high - low).max()) * _SQUARE_M, _SQUARES) / _SQUARE_M))
    low = low // step * step
    size = -(-(high - low) // step)
    padded = np.zeros(size * step, np.int64)
    part = counts[low[0] : low[0] + size[0] * step, low[1] : low[1] + size[1] * step]
    padded[: part.shape[0], : part.shape[1]] = part
    merged = padded.reshape(size[0], step, size[1], step).sum(axis=(1, 3))
    first = low * _SQUARE_M - _REACH_M
    return step * _SQUARE_M, (round(float(first[0]), 3), round(float(first[1]), 3)), merged

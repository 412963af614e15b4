"""Frame rates, time and windows. Every rounding between seconds, frames, rows and samples is here."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

from dancedata.core.errors import UsageError
from dancedata.core.text import quoted

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    IntArray = npt.NDArray[np.int64]
    BoolArray = npt.NDArray[np.bool_]

Number = int | float | str | Fraction
#: Limits the exponent: "1e999999999" would make a number of a billion digits.
_NUMBER = re.compile(r"\s*[+-]?(\d{1,40}(\.\d{0,40})?|\.\d{1,40})([eE][+-]?\d{1,3}|/\d{1,40})?\s*")


def as_fraction(value: Number, what: str) -> Fraction:
    """Return `value` as it is written, 29.97 as 2997/100; UsageError for anything but a finite number.

    Examples
    --------
    >>> from dancedata.core.grid import as_fraction
    >>> as_fraction(29.97, "rate")
    Fraction(2997, 100)
    >>> as_fraction("30000/1001", "rate")
    Fraction(30000, 1001)
    """
    try:
        if isinstance(value, str) and not _NUMBER.fullmatch(value):
            raise ValueError(value)
        return Fraction(str(value)) if isinstance(value, float) else Fraction(value)
    except (ValueError, ZeroDivisionError, TypeError, OverflowError) as error:
        raise UsageError(
            f"{what} is not a number", found=quoted(value, 60), allowed="a number or a fraction such as 30000/1001"
        ) from error


def as_rate(value: Number) -> Fraction:
    """Return a rate (per second) as an exact fraction; UsageError for anything but a number above 0.

    Examples
    --------
    >>> from dancedata.core.grid import as_rate
    >>> as_rate("30000/1001")
    Fraction(30000, 1001)
    """
    rate = as_fraction(value, "rate")
    if rate <= 0:
        raise UsageError("a frame rate must be above 0", found=quoted(value, 60), allowed="frames per second, > 0")
    return rate


@dataclass(frozen=True, order=True)
class FrameGrid:
    """Frames at a constant, exact rate; frame k is the instant k / rate seconds.

    Rows of a field, samples of music and frames of a motion are all frames of some grid. The methods that take `of`
    convert between two grids that begin at the same instant: "rows" are frames of the other grid.

    Attributes
    ----------
    rate
        Frames per second.

    Examples
    --------
    >>> from dancedata.core.grid import FrameGrid
    >>> grid = FrameGrid.of(30)
    >>> grid.frames(2.5)
    75
    >>> grid.seconds(150)
    Fraction(5, 1)
    >>> FrameGrid.of(60).step_to(grid)
    2
    """

    rate: Fraction

    @classmethod
    def of(cls, rate: Number) -> FrameGrid:
        """Make a grid from anything that `as_rate` takes."""
        return cls(as_rate(rate))

    def divided(self, n: int) -> FrameGrid:
        """Return the grid with `n` instants in each frame of this one, such as 512 samples per frame."""
        return FrameGrid(n * self.rate)

    def frames(self, seconds: Number, what: str = "length") -> int:
        """Return how many frames `seconds` are, exactly; UsageError for a part of a frame."""
        exact = as_fraction(seconds, what) * self.rate
        if exact.denominator != 1:
            nearest = float(max(1, round(exact)) / self.rate)
            raise UsageError(f"{what} is not a whole number of frames",
                             found=f"{seconds} s = {float(exact):.6g} frames at {self.rate} per second",
                             allowed=f"multiples of {float(1 / self.rate):.6g} s",
                             fix=f"give it in frames, or choose {nearest:.6g} s")  # fmt: skip
        return int(exact)

    def frames_up(self, seconds: Fraction) -> int:
        """Return how many frames `seconds` are, rounded up."""
        return math.ceil(seconds * self.rate)

    def seconds(self, frames: int) -> Fraction:
        """Return the time of a frame, or the duration of `frames` frames, in seconds."""
        return frames / self.rate

    def rows(self, frames: int, *, of: FrameGrid, what: str = "") -> int:
        """Return how many rows of the grid `of` take exactly as long as `frames` frames of this one.

        It is also the row at the same instant as frame `frames`. UsageError, about `what`, for a part of a row.
        """
        period, other_period = self.common_period(of)
        rows, rest = divmod(int(frames) * other_period, period)
        if rest:
            raise UsageError(f"{what or 'a number of frames'} is not a whole number of rows",
                             found=f"{frames} frames at {self} per second, rows at {of} per second",
                             allowed=f"multiples of {period} frames")  # fmt: skip
        return rows

    def is_whole(self, frames: int, *, of: FrameGrid) -> bool:
        """Whether `frames` frames are a whole number of rows of the grid `of`."""
        period, other_period = self.common_period(of)
        return frames * other_period % period == 0

    def rows_down(self, frames: int, *, of: FrameGrid) -> int:
        """Return how many rows of the grid `of` end within `frames` frames: rounded down."""
        period, other_period = self.common_period(of)
        return int(frames) * other_period // period

    def rows_up(self, frames: int, *, of: FrameGrid) -> int:
        """Return how many rows of `of` begin within `frames` frames, rounded up: the first row at or after it."""
        period, other_period = self.common_period(of)
        return -(-int(frames) * other_period // period)

    def rows_of_all(self, frames: IntArray, *, of: FrameGrid) -> tuple[IntArray, BoolArray]:
        """Return `rows_down` and `is_whole` of many numbers of frames, (N,) int64 each."""
        period, other_period = self.common_period(of)
        rows = frames * other_period
        if period == 1:  # spares a million windows a division by 1
            return rows, frames == frames
        rows, rest = divmod(rows, period)
        return rows, rest == 0

    def nearest_rows(self, frames: IntArray, *, of: FrameGrid) -> IntArray:
        """Return the row of the grid `of` nearest to each of many frames, (N,) int64; ties go to the later row."""
        period, other_period = self.common_period(of)
        return (2 * frames * other_period + period) // (2 * period)

    def common_period(self, of: FrameGrid) -> tuple[int, int]:
        """Return the least number of frames of this grid, and of rows of the other, that take equally long."""
        # Whole numbers: arithmetic with Fraction takes ten times as long.
        (numerator, denominator), (other, below) = self._ratio, of._ratio
        if numerator == other and denominator == below:
            return 1, 1
        frames, rows = numerator * below, other * denominator
        divisor = math.gcd(frames, rows)
        return frames // divisor, rows // divisor

    @cached_property
    def _ratio(self) -> tuple[int, int]:
        return self.rate.numerator, self.rate.denominator

    def step_to(self, target: FrameGrid) -> int | None:
        """Return the step that decimates this grid to `target`, or None if the ratio is not whole."""
        period, other_period = self.common_period(target)
        return period if other_period == 1 else None

    def resampled_length(self, n_frames: int, target: FrameGrid) -> int:
        """Return how many frames of `target` lie within the span of `n_frames` frames, both ends included.

        A frame is an instant: 1,919 frames at 60 FPS span 0 .. 1918 / 60 s, that is 960 frames at 30 FPS.
        """
        return self.rows_down(n_frames - 1, of=target) + 1 if n_frames > 0 else 0

    def places(self, n: int, target: FrameGrid) -> npt.NDArray[np.float64]:
        """Return where the first n frames of `target` lie between the frames of this grid, (n,) frames."""
        import numpy as np

        period, target_period = self.common_period(target)
        # Multiplied before divided: in floating point k * (2 / 3) can fall below an integer frame.
        return np.arange(n, dtype=np.float64) * period / target_period

    def __repr__(self) -> str:
        return f"FrameGrid.of({self.rate.numerator if self.rate.denominator == 1 else str(self.rate)!r})"

    def __str__(self) -> str:
        return str(self.rate)


@dataclass(frozen=True)
class WindowGrid:
    """Windows of `length` frames, one every `stride` frames, each at least 1: window k begins at frame k * stride.

    Examples
    --------
    >>> from dancedata.core.grid import WindowGrid
    >>> grid = WindowGrid(length=150, stride=75)
    >>> grid.count(300)
    3
    >>> list(grid.starts(3))
    [0, 75, 150]
    """

    length: int
    stride: int

    def __post_init__(self) -> None:
        if self.length < 1 or self.stride < 1:
            raise UsageError("windows need a length and a stride of at least one frame",
                             found=f"length {self.length}, stride {self.stride}")  # fmt: skip

    def count(self, n_frames: int) -> int:
        """Return how many windows fit into `n_frames` frames."""
        return (n_frames - self.length) // self.stride + 1 if n_frames >= self.length else 0

    def start(self, number: int) -> int:
        """Return the first frame of a window."""
        return number * self.stride

    def number(self, start: int) -> int:
        """Return the number of the window that begins at frame `start`."""
        return start // self.stride

    def starts(self, count: int) -> range:
        """Return the first frames of the first `count` windows."""
        return range(0, count * self.stride, self.stride)

    def times(self, factor: int) -> WindowGrid:
        """Return the same windows counted at `factor` times the frame rate."""
        return WindowGrid(self.length * factor, self.stride * factor)


@dataclass(frozen=True)
class WindowSpec(WindowGrid):
    """Windows in frames of a grid."""

    grid: FrameGrid

    @property
    def length_s(self) -> float:
        """Length in seconds."""
        return float(self.grid.seconds(self.length))

    @property
    def stride_s(self) -> float:
        """Stride in seconds."""
        return float(self.grid.seconds(self.stride))

    def document(self) -> dict[str, int]:
        """Return all keys, defaults included."""
        return {"length_frames": self.length, "stride_frames": self.stride}

"""Frame rates and time. Every rounding between seconds and frames is here."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

from dancedata.core.errors import UsageError
from dancedata.core.text import quoted

Number = int | float | str | Fraction
#: Short enough that no exponent asks for a number of a million digits, as "1e999999999" would.
_NUMBER = re.compile(r"\s*[+-]?(\d{1,40}(\.\d{0,40})?|\.\d{1,40})([eE][+-]?\d{1,3}|/\d{1,40})?\s*")


def as_fraction(value: Number, what: str) -> Fraction:
    """Return `value` as it is written: 29.97 is 2997/100, not the nearest binary number.

    Raises
    ------
    UsageError
        If `value` is no finite number.
    """
    try:
        if isinstance(value, str) and not _NUMBER.fullmatch(value):
            raise ValueError(value)
        return Fraction(str(value)) if isinstance(value, float) else Fraction(value)
    except (ValueError, ZeroDivisionError, TypeError, OverflowError) as error:
        raise UsageError(
            f"{what} is no number", found=quoted(value, 60), allowed="a number or a fraction such as 30000/1001"
        ) from error


def as_rate(value: Number) -> Fraction:
    """Return a rate (per second) as an exact fraction; "30000/1001" is 29.97 NTSC.

    Raises
    ------
    UsageError
        If `value` is not a number above 0.
    """
    rate = as_fraction(value, "rate")
    if rate <= 0:
        raise UsageError("a frame rate must be above 0", found=quoted(value, 60), allowed="frames a second, > 0")
    return rate


@dataclass(frozen=True, order=True)
class FrameGrid:
    """Frames at a constant, exact rate; frame k is the instant k / rate seconds.

    Attributes
    ----------
    rate
        Frames a second.
    """

    rate: Fraction

    @classmethod
    def of(cls, rate: Number) -> FrameGrid:
        """Make a grid from anything that `as_rate` takes."""
        return cls(as_rate(rate))

    def frames(self, seconds: Number, what: str = "length") -> int:
        """Return how many frames `seconds` are, exactly.

        Raises
        ------
        UsageError
            If it is no whole number of frames.
        """
        exact = as_fraction(seconds, what) * self.rate
        if exact.denominator != 1:
            raise UsageError(
                f"{what} is no whole number of frames",
                found=f"{seconds} s = {float(exact):.6g} frames at {self.rate} a second",
                allowed=f"multiples of {float(1 / self.rate):.6g} s",
                fix=f"give it in frames, or choose {float(max(1, round(exact)) / self.rate):.6g} s",
            )
        return int(exact)

    def seconds(self, frames: int) -> Fraction:
        """Return the time of a frame, or the duration of `frames` frames, in seconds."""
        return frames / self.rate

    def step_to(self, target: FrameGrid) -> int | None:
        """Return the step that decimates this grid to `target`, or None if the ratio is not whole."""
        here, there = self._per(target)
        return here // there if here % there == 0 else None

    def resampled_length(self, n_frames: int, target: FrameGrid) -> int:
        """Return how many frames of `target` lie within the span of `n_frames` frames, both ends included.

        A frame is an instant: 1,919 frames at 60 FPS span 0 .. 1918 / 60 s, that is 960 frames at 30 FPS.
        """
        if n_frames <= 0:
            return 0
        here, there = self._per(target)
        return (int(n_frames) - 1) * there // here + 1

    def first_frame_from(self, frame: int, target: FrameGrid) -> int:
        """Return the first frame of `target` that does not lie before `frame` of this grid."""
        here, there = self._per(target)
        return -(-int(frame) * there // here)

    def _per(self, target: FrameGrid) -> tuple[int, int]:
        """Return whole numbers that are to each other as the two rates: Fraction takes ten times as long."""
        here, there = self.rate, target.rate
        return here.numerator * there.denominator, there.numerator * here.denominator

    def row(self, frame: int, other: FrameGrid) -> int:
        """Return the row of `other` that lies at the same instant as `frame`.

        Raises
        ------
        UsageError
            If `other` has no row at that instant.
        """
        exact = frame * other.rate / self.rate
        if exact.denominator != 1:
            raise UsageError(
                f"frame {frame} at {self.rate} a second lies between two rows at {other.rate} a second",
                found=f"row {float(exact):.6g}",
                allowed="frames at the same instant as a row",
            )
        return int(exact)

    def __repr__(self) -> str:
        """Show what makes an equal grid: FrameGrid.of(30) or FrameGrid.of('30000/1001')."""
        return f"FrameGrid.of({self.rate.numerator if self.rate.denominator == 1 else str(self.rate)!r})"

    def __str__(self) -> str:
        """Show the rate: 30 or 30000/1001."""
        return str(self.rate)

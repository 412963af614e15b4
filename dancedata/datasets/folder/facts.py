"""Facts about a motion file: frame rate, up axis, unit, layout, gender.

The manifest decides (one file), else the file, else the recipe (files that do not state the fact), else an error.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError, did_you_mean
from dancedata.formats.body_model import GENDERS
from dancedata.formats.video_pose import TOOLS

MIN_RATE, MAX_RATE = 1, 10_000

_NTSC = tuple(Fraction(k * 1000, 1001) for k in (24, 30, 60, 120))
_USUAL = tuple(
    Fraction(k) for k in (24, 25, 30, 48, 50, 60, 72, 75, 80, 90, 96, 100, 120, 144, 150, 180, 200, 240, 250, 300)
)
#: Rates that a rounded number may stand for, in order of preference.
_KNOWN = (*_USUAL, *(Fraction(k) for k in (360, 400, 480, 500, 600, 1000)), *_NTSC)
#: A number is read as a known rate within this fraction of it, ...
_CLOSE = Fraction(1, 1_000_000)
#: ... or, for a period, within one unit of its last decimal, but at most this fraction.
_ROUNDED = Fraction(15, 1000)
#: A rate this near a usual one, but not equal to it, may come of a rounded frame time: 0.016 s is 62.5 FPS, not 60.
_NEAR = Fraction(5, 100)
_NUMBER = re.compile(r"\+?(\d{1,9}\.?\d{0,30}|\.\d{1,30})([eE][+-]?\d{1,2})?")


def rate_of_text(text: str) -> Fraction | None:
    """Return a rate such as "60", "59.94" or "30000/1001" exactly as written; None if it is not a rate.

    Only short numbers are accepted: "1e999999999" would have a billion digits.
    """
    top, slash, bottom = text.strip().partition("/")
    if not _NUMBER.fullmatch(top) or (slash and not _NUMBER.fullmatch(bottom)):
        return None
    below = Fraction(bottom) if slash else Fraction(1)
    return _in_range(Fraction(top) / below) if below else None


def exact_rate(value: float) -> Fraction | None:
    """Return the rate that a file stores as a binary number; None if it is not a rate.

    A value within one millionth of a usual rate is that rate (59.94005994 is 60000/1001, and 120.00000763,
    rounded to 32 bits, is 120); any other is taken as written.
    """
    rate = rate_of_text(repr(float(value)))
    if rate is None:
        return None
    near = [usual for usual in (*_KNOWN, Fraction(round(rate))) if abs(rate - usual) <= usual * _CLOSE]
    return near[0] if near else rate


def rate_of_period(text: str) -> Fraction | None:
    """Return the rate of a frame time in seconds, as written: "0.0333333" is 30, ".0083333" 120.

    A frame time is a rounded number. It is read as a usual rate whose frame time differs by at most one
    unit of the last decimal (or one millionth of it), and by at most 1.5 %: integer rates first, the closest
    first, then NTSC rates such as 24000/1001. Otherwise the rate is exactly 1 / text.
    """
    period = Fraction(text)
    mantissa, _, exponent = text.lower().partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
    unit = Fraction(1, 10**decimals) if decimals >= 0 else Fraction(10**-decimals)
    slack = min(max(unit, period * _CLOSE), period * _ROUNDED)
    for group in (tuple(k for k in _KNOWN if k not in _NTSC), _NTSC):
        near = sorted((abs(period - 1 / rate), rate) for rate in group if abs(period - 1 / rate) <= slack)
        if near:
            exactly = [rate for rate in _NTSC if abs(period - 1 / rate) <= period * _CLOSE]
            return exactly[0] if exactly and near[0][0] > period * _CLOSE else near[0][1]
    return _in_range(1 / period)


def drift_note(rate: Fraction) -> str:
    """Return what a rate near a usual one may mean, for notes; "" for a usual rate and one far from all."""
    usual = min(_USUAL, key=lambda candidate: abs(candidate - rate))
    if rate in _KNOWN or abs(rate - usual) > usual * _NEAR:
        return ""
    drift = float(60 * abs(1 - usual / rate))
    return (
        f"{float(rate):.6g} FPS is near {usual}: a capture at {usual} whose frame time was rounded drifts from its "
        f"music by {drift:.2g} s per minute; if it is one, declare fps: {usual} in the manifest"
    )


def _in_range(rate: Fraction) -> Fraction | None:
    return rate if MIN_RATE <= rate <= MAX_RATE else None


T = TypeVar("T")
Floats = NDArray[np.float64]

LAYOUTS = ("auto", "amass", "smpl", "smplh", "smplx", "finedance", *TOOLS, "motionx", "humanml3d", "positions")
#: Metres per unit. "cmu": the files of the CMU database are in inches / 0.45.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "cmu": 0.0254 / 0.45}
GUESS = "guess"
#: Rotation from a file's axes to +Y up, by the file's up axis; -y are a camera's axes, +Z away from it.
UPRIGHT: Mapping[str, Floats] = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-y": np.diag([1.0, -1.0, -1.0]),
}
IN_MANIFEST, IN_RECIPE = "declared in the manifest", "declared in the recipe"


@dataclass(frozen=True)
class Fact(Generic[T]):
    """A fact about a file, and its origin."""

    value: T
    where: str

    def __str__(self) -> str:
        return f"{self.value} ({self.where})"


@dataclass(frozen=True)
class Declared:
    """Declarations for one file or for all; None where nothing is declared.

    `fps`: As text, such as "30" or "30000/1001".
    `unit`: A name in UNITS, "guess", or metres per unit as text.
    `person`: The file's own name for one of its people.
    `joint_map`: SMPL joint -> name in the BVH, or the name of a producer, as JSON.
    """

    fps: str | None = None
    up: str | None = None
    unit: str | None = None
    layout: str | None = None
    gender: str | None = None
    person: str | None = None
    joint_map: str | None = None

    @property
    def rate(self) -> Fraction | None:
        """The frame rate."""
        return None if self.fps is None else rate_of_text(self.fps)

    def problem(self) -> tuple[str, str, str] | None:
        """Return (name, value, allowed values) of the first invalid value; None if all are valid."""
        if self.fps is not None and rate_of_text(self.fps) is None:
            return "fps", self.fps, f"{MIN_RATE} to {MAX_RATE:,} frames per second, such as 30, 59.94 or 30000/1001"
        for name, allowed in (("up", tuple(UPRIGHT)), ("layout", LAYOUTS), ("gender", GENDERS)):
            value = getattr(self, name)
            if value is not None and value not in allowed:
                return name, value, did_you_mean(value, allowed)
        if self.unit is not None and self.unit != GUESS and metres(self.unit) is None:
            return "unit", self.unit, f"{', '.join(UNITS)}, guess (for BVH), or metres per unit, such as 0.0254"
        return None


def metres(unit: str) -> float | None:
    """Return the metres per unit, given by name or as a number above 0; None if it is neither."""
    if unit in UNITS:
        return UNITS[unit]
    if len(unit) > 40:
        return None
    try:
        value = float(unit)
    except ValueError:
        return None
    return value if 1e-6 <= value <= 1e6 else None


def decide(manifest: T | None, file: Fact[T] | None, recipe: T | None) -> Fact[T] | None:
    """Return the fact from the manifest, else from the file, else from the recipe."""
    if manifest is not None:
        return Fact(manifest, IN_MANIFEST)
    if file is not None:
        return file
    return None if recipe is None else Fact(recipe, IN_RECIPE)


def undeclared(path: Path, key: str, what: str, allowed: str, found: str, also: Sequence[str] = ()) -> DataError:
    """Return the DataError for an unknown fact; `also`: keys of further unknown facts, to declare as well."""
    others = f". Declare {' and '.join(also)} as well, also unknown" if also else ""
    return DataError(f"the {what} of this file is unknown", reason="undeclared", where=str(path), found=found,
                     allowed=allowed,
                     fix=f"declare {key}: in a column of the manifest, or for all files in the recipe "
                     f"(--set dataset.folder.{key}=...){others}")  # fmt: skip


def bad_declaration(path: Path, problem: str, found: str, allowed: str, fix: str) -> DataError:
    """Return the DataError for a declaration that contradicts its file."""
    return DataError(problem, reason="bad_declaration", where=str(path), found=found, allowed=allowed, fix=fix)

"""What motion files state: the frame rate, the unit, the axis that is up, and the names of joints."""

import re
from collections.abc import Mapping
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.text import shown
from dancedata.formats.arrays import ArrayFile

#: Names of arrays with the frame rate, and with the names of joints.
RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps", "frame_rate", "framerate")
JOINT_NAMES = ("joint_names", "joints_names", "joints", "names")
#: The array that says which dancers of a file of groups are there.
PERSON_MASK = "person_mask"
#: Metres per unit. "cmu": the files of the CMU database are in inches / 0.45.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "cmu": 0.0254 / 0.45}
#: Rotation from a file's axes to +Y up, by the file's up axis; -y are a camera's axes, +Z away from it.
UPRIGHT: Mapping[str, NDArray[np.float64]] = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-y": np.diag([1.0, -1.0, -1.0]),
}
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
    """Return a rate such as "59.94" or "30000/1001" exactly as written; None for any other text, or long ones."""
    top, slash, bottom = text.strip().partition("/")
    if not _NUMBER.fullmatch(top) or (slash and not _NUMBER.fullmatch(bottom)):
        return None
    below = Fraction(bottom) if slash else Fraction(1)
    return _in_range(Fraction(top) / below) if below else None


def exact_rate(value: float) -> Fraction | None:
    """Return the usual rate within a millionth of a number (59.94005994 is 60000/1001), else the number; or None."""
    rate = rate_of_text(repr(float(value)))
    if rate is None:
        return None
    near = [usual for usual in (*_KNOWN, Fraction(round(rate))) if abs(rate - usual) <= usual * _CLOSE]
    return near[0] if near else rate


def rate_of_period(text: str) -> Fraction | None:
    """Return the rate of a frame time in seconds, as written: "0.0333333" is 30, ".0083333" 120.

    It is a usual rate, whole ones first, if its frame time differs by at most one unit of the last decimal and 1.5 %;
    otherwise exactly 1 / text.
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


def stored_rate(arrays: ArrayFile, key: str) -> Fraction:
    """Return the rate that a file states, as one number or text ("120", b"120.0", "30000/1001"); DataError."""
    try:
        text = arrays.text(key)
        values = [] if text else arrays.read(key).reshape(-1).tolist()
        stated = text or str(values[:3])
    except DataError as error:  # several texts, objects
        text, values, stated = "", [], str(error.found)
    rate = rate_of_text(text) if text else exact_rate(values[0]) if len(values) == 1 else None
    if rate is not None and text and "/" not in text:
        rate = exact_rate(float(rate))
    if rate is None:
        raise DataError(
            f"{key} is not a frame rate",
            reason="bad_rate",
            where=str(arrays.path),
            found=shown(stated),
            allowed=f"one number or its text, {MIN_RATE} to {MAX_RATE:,} frames per second",
            fix=f"declare fps for this file in the manifest, or save it again with {key}=numpy.array(120.0)",
        )
    return rate


def stated_grid(arrays: ArrayFile) -> FrameGrid | None:
    """Return the frame rate that a file states, None without one; DataError ("bad_rate") if it is not a rate."""
    key = next((name for name in RATE_KEYS if name in arrays.names), None)
    return None if key is None else FrameGrid(stored_rate(arrays, key))


def same_rate(stated: FrameGrid | None, grid: FrameGrid) -> bool:
    """Return whether a file states no rate, or that of `grid`; 29.97 and 30000/1001 are the same."""
    return stated is None or abs(stated.rate / grid.rate - 1) < 1e-4


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

"""Exact frame rates from text, rounded numbers and frame times."""

from __future__ import annotations

import re
from fractions import Fraction

__all__ = ["MAX_RATE", "MIN_RATE", "drift_note", "exact_rate", "rate_of_period", "rate_of_text"]

MIN_RATE, MAX_RATE = 1, 10_000

_NTSC = tuple(Fraction(k * 1000, 1001) for k in (24, 30, 60, 120))
_USUAL = tuple(
    Fraction(k) for k in (24, 25, 30, 48, 50, 60, 72, 75, 80, 90, 96, 100, 120, 144, 150, 180, 200, 240, 250, 300)
)
#: Rates that a rounded number may stand for, in order of preference.
_KNOWN = (*_USUAL, *(Fraction(k) for k in (360, 400, 480, 500, 600, 1000)), *_NTSC)
#: A number stands for a known rate within this fraction of it, ...
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
    near = [known for known in (*_KNOWN, Fraction(round(rate))) if abs(rate - known) <= known * _CLOSE]
    return near[0] if near else rate


def rate_of_period(text: str) -> Fraction | None:
    """Return the rate of a frame time in seconds, as written: "0.0333333" is 30, ".0083333" 120.

    A frame time is a rounded number. It stands for a usual rate whose frame time differs by at most one
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
    usual = min(_USUAL, key=lambda known: abs(known - rate))
    if rate in _KNOWN or abs(rate - usual) > usual * _NEAR:
        return ""
    drift = float(60 * abs(1 - usual / rate))
    return (
        f"{float(rate):.6g} FPS is near {usual}: a capture at {usual} whose frame time was rounded drifts from its "
        f"music by {drift:.2g} s per minute; if it is one, declare fps: {usual} in the manifest"
    )


def _in_range(rate: Fraction) -> Fraction | None:
    return rate if MIN_RATE <= rate <= MAX_RATE else None

"""Music without sound: silent, constant, or without an onset, in the part of it that a clip has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.quality import SILENT_DBFS

#: Pieces of a second whose levels are compared.
_PIECES = 20
#: Level of what has no power, dBFS.
_NOTHING = -200
#: Music whose level changes by less between twentieths of a second has no onset, dB: a hum. Noise has 0.4 and more.
_STEADY_DB = 0.2

#: Level of a second, and of its quietest and its loudest piece, tenths of dBFS.
Level = tuple[int, int, int]


def levels(signal: AudioSignal) -> list[Level]:
    """Return the levels of each whole second, at least of one; a constant has no level."""
    length = max(1, signal.sample_rate // _PIECES)
    n = max(1, len(signal.samples) // length)
    pieces = np.resize(signal.samples, (n, length)) if len(signal.samples) < length else None
    pieces = signal.samples[: n * length].reshape(n, length) if pieces is None else pieces
    power = np.var(pieces, axis=1, dtype=np.float64)
    seconds = [power[k : k + _PIECES] for k in range(0, max(1, n - n % _PIECES), _PIECES)]
    return [(_tenths(float(of.mean())), _tenths(float(of.min())), _tenths(float(of.max()))) for of in seconds]


def _tenths(power: float) -> int:
    return round(100 * math.log10(power)) if power > 10 ** (_NOTHING / 10) else 10 * _NOTHING


def noted(signal: AudioSignal, start: Fraction, seconds: Fraction) -> list[tuple[str, float]]:
    """Return (kind of flag, value) of a part of decoded music: where it has no sound, and what decoding noticed."""
    return [*without_sound(levels(signal), start, seconds), *signal.findings]


def without_sound(of_music: Sequence[Level], start: Fraction, seconds: Fraction) -> list[tuple[str, float]]:
    """Return ("silent_music", dBFS) or ("steady_music", dB) of a part of music without sound; else nothing."""
    # Whole seconds inside the part; of a short one those that it touches.
    first, last = math.ceil(start), math.floor(start + seconds)
    first, last = (first, last) if first < last else (math.floor(start), math.ceil(start + seconds))
    part = of_music[max(0, first) : max(0, last)]
    if not part:
        return []
    level = 10 * math.log10(sum(10 ** (mean / 100) for mean, _, _ in part) / len(part))
    if level < SILENT_DBFS:
        return [("silent_music", round(level, 1))]
    change = (max(most for _, _, most in part) - min(least for _, least, _ in part)) / 10
    return [("steady_music", change)] if change < _STEADY_DB else []

"""Onset strength of music in bands, on a grid that is finer than frames of motion."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import AudioSignal

#: Borders of its bands, Hz: kick and bass, snare and voices, hats and consonants.
BANDS_HZ = (30.0, 200.0, 2000.0, 10_000.0)
#: Length of the Hann window of a spectrum, and of the step over which its rise is measured, seconds.
_WINDOW_S, _STEP_S = 0.024, 1 / 60
#: The logarithm of an onset's power rises before the onset is in the middle of the window: by this much, seconds
#: (4 to 7 ms for noise that begins suddenly).
_EARLY_S = 0.005
#: Power relative to the loudest row of a band from which a rise counts: -40 dB.
_FLOOR = 1e-4
#: Rows whose spectra are in memory at once.
_ROWS = 4096


def onset_strength(signal: AudioSignal, rate: int = 240) -> NDArray[np.float64]:
    """Return how fast the music becomes louder in three bands, (T, 3) dB per row, at second t / `rate`.

    The power of a short spectrum is summed in each band; its logarithm's rise over 1/60 s, centred on the instant of
    the row, is the strength of an onset, and falls count as 0 (log spectral flux; Bello et al. 2005, A tutorial on
    onset detection in music signals). No matrix product is used, so the result is the same with every BLAS.
    """
    power = _band_power(signal, rate)
    if not len(power):
        return power
    level = 10 * np.log10(power + _FLOOR * power.max(axis=0, initial=0.0) + 1e-20)
    half = round(_STEP_S * rate / 2)
    padded = np.pad(level, ((half, half), (0, 0)), mode="edge")
    return np.asarray(np.maximum(padded[2 * half :] - padded[: -2 * half], 0.0))


def _band_power(signal: AudioSignal, rows_per_s: int) -> NDArray[np.float64]:
    """Return the power (T, 3) in each band around each row."""
    rate = signal.sample_rate
    half = max(2, round(_WINDOW_S * rate / 2))
    n_rows = math.floor(len(signal.samples) * rows_per_s / rate)
    early = round(_EARLY_S * rate)
    samples = np.pad(signal.samples.astype(np.float64), (half + early, half))
    centres = np.arange(n_rows) * rate // rows_per_s
    window = np.hanning(2 * half + 1)[:-1]
    pieces = np.lib.stride_tricks.sliding_window_view(samples, 2 * half)
    size = 1 << (2 * half - 1).bit_length()
    borders = [min(round(hz * size / rate), size // 2 + 1) for hz in BANDS_HZ]
    power = np.zeros((n_rows, len(BANDS_HZ) - 1))
    for first in range(0, n_rows, _ROWS):
        spectra = np.fft.rfft(pieces[centres[first : first + _ROWS]] * window, size)
        energy = spectra.real**2 + spectra.imag**2
        for band, (low, high) in enumerate(pairwise(borders)):
            power[first : first + _ROWS, band] = energy[:, low:high].sum(axis=1)
    return power

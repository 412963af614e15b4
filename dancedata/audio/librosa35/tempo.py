"""Tempo of windows from their onset envelopes: librosa's `tempo`, many windows at a time.

The autocorrelation of eight seconds around every frame, scaled to 1 at lag 0, is averaged over frames and weighted
by the distance of its tempo from the expected one (Ellis, "Beat tracking by dynamic programming", 2007). The
transform back to lags is linear, so power spectra are averaged and only the mean is transformed back. This is done in
float32, and in double precision again where the two best tempos are closer than the rounding.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.librosa35.arrays import Floats, strided
from dancedata.audio.librosa35.settings import HOP
from dancedata.audio.librosa35.spectra import hann

_WINDOW_S = 8.0
_MAX_BPM = 320.0
_FRAMES_AT_ONCE = 256
_MIN_RISE = np.float32(1e-12)
# Bound on the float32 rounding of the mean autocorrelation, which is 1 at lag 0; seen: up to 2e-7.
_FLOAT32_ERROR = 2e-6


def window_tempos(envelopes: Floats, rate: int, start_bpm: float) -> NDArray[np.float64]:
    """Return the most likely tempo around `start_bpm` of each envelope (W, T), in beats per minute."""
    tempos, log_prior = _tempos_and_prior(rate, start_bpm)
    single = _mean_autocorrelations(envelopes, len(tempos), np.dtype(np.float32))
    score = _score(single, log_prior)
    best = score.argmax(axis=1)
    for window in np.flatnonzero(_is_close(score, best, single) | _is_too_faint(envelopes)):
        double = _mean_autocorrelations(envelopes[[window]], len(tempos), np.dtype(np.float64))
        best[window] = _score(double, log_prior)[0].argmax()
    found: NDArray[np.float64] = tempos[best]
    return found


@lru_cache(maxsize=64)
def _tempos_and_prior(rate: int, start_bpm: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Tempos of lags 0, 1, ... in beats per minute, and the logarithm of their prior."""
    n_lags = int(_WINDOW_S * rate) // HOP
    with np.errstate(divide="ignore"):
        tempos = 60.0 * rate / (HOP * np.arange(float(n_lags)))
    prior = -0.5 * (np.log2(tempos) - np.log2(start_bpm)) ** 2
    prior[: int(np.argmax(tempos < _MAX_BPM))] = -np.inf
    return tempos, prior


def _score(autocorrelation: NDArray[np.float64], log_prior: NDArray[np.float64]) -> NDArray[np.float64]:
    # Envelopes are not negative, so below zero is rounding.
    score: NDArray[np.float64] = np.log1p(1e6 * np.maximum(autocorrelation, 0.0)) + log_prior
    return score


def _is_too_faint(envelopes: Floats) -> NDArray[np.bool_]:
    """Return which envelopes (W, T) have values whose squares underflow in float32; those of real audio do not."""
    return np.asarray(((envelopes > 0) & (envelopes < _MIN_RISE)).any(axis=1))


def _is_close(
    score: NDArray[np.float64], best: NDArray[np.int64], autocorrelation: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return for which windows rounding in float32 may decide which score (W, lags) is the best."""
    error = 1e6 * _FLOAT32_ERROR / (1.0 + 1e6 * np.maximum(autocorrelation, 0))
    windows = np.arange(len(best))
    reach = score + error >= (score[windows, best] - error[windows, best])[:, np.newaxis]
    reach[windows, best] = False
    return np.asarray(reach.any(axis=1))


def _mean_autocorrelations(envelopes: Floats, n_lags: int, dtype: np.dtype[np.floating]) -> NDArray[np.float64]:
    """Return the mean (W, n_lags) over frames of the scaled autocorrelations around them."""
    import scipy.fft

    n_frames, reach = envelopes.shape[1], n_lags // 2
    padded = np.pad(envelopes, ((0, 0), (reach, reach)), mode="linear_ramp", end_values=0).astype(dtype)
    frames = strided(padded, (len(padded), n_frames, n_lags), (padded.shape[1], 1, 1))
    window = hann(n_lags).astype(dtype)
    size = scipy.fft.next_fast_len(2 * n_lags - 1, real=True)
    power = np.zeros((len(envelopes), 2 * (size // 2 + 1)), dtype=dtype)
    work = np.zeros((min(n_frames, _FRAMES_AT_ONCE), size), dtype=dtype)
    for w in range(len(envelopes)):
        for first in range(0, n_frames, _FRAMES_AT_ONCE):
            part = frames[w, first : first + _FRAMES_AT_ONCE]
            windowed = np.multiply(part, window, out=work[: len(part), :n_lags])
            energy = np.einsum("tn,tn->t", windowed, windowed)
            weight = np.divide(1, energy, out=np.zeros_like(energy), where=energy >= np.finfo(dtype).tiny)
            spectrum = scipy.fft.rfft(work[: len(part)], axis=1).view(dtype)
            # Real and imaginary parts alternate.
            power[w] += weight @ np.square(spectrum, out=spectrum)
    summed = (power[:, 0::2] + power[:, 1::2]).astype(np.float64)
    mean: NDArray[np.float64] = scipy.fft.irfft(summed, n=size, axis=1)[:, :n_lags] / n_frames
    return mean

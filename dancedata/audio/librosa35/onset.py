"""Onset envelope, MFCC and onset peaks of windows, from their rows of the mel spectrum.

As librosa's `onset_strength`, `mfcc` and `onset_detect` with their defaults. The limit to the upper 80 dB, the
scaling of the envelope and the picking of peaks are per window.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.librosa35.arrays import Floats
from dancedata.audio.librosa35.settings import HOP
from dancedata.audio.librosa35.spectra import N_FFT, N_MELS

N_MFCC = 20
TOP_DB = np.float32(80.0)
# Frame 0 has no frame before it, and the envelope is moved by half an STFT frame.
LAG = 1 + N_FFT // (2 * HOP)
_DELTA = np.float64(np.float32(0.07))


def envelope_and_mfcc(db: Floats, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Compute the onset envelopes (W, T) and MFCC (W, T, 20) of windows.

    Parameters
    ----------
    db
        (R, 128) rows of the mel spectrum in dB.
    rows
        (W, T) the rows of each window.
    """
    n_windows, n_frames = rows.shape
    envelope = np.zeros((n_windows, n_frames), dtype=np.float32)
    mfcc = np.empty((n_windows, n_frames, N_MFCC), dtype=np.float32)
    for window, frames in enumerate(rows):
        limited = db[frames]
        np.maximum(limited, limited.max() - TOP_DB, out=limited)
        # A constant affects coefficient 0 only, and smaller numbers lose less to rounding.
        floor = limited.min()
        mfcc[window] = (limited - floor) @ _dct()
        mfcc[window, :, 0] += floor * np.float32(np.sqrt(N_MELS))
        rise = limited[1:] - limited[:-1]
        np.maximum(rise, np.float32(0), out=rise)
        envelope[window, LAG:] = rise.mean(axis=1)[: n_frames - LAG]
    return envelope, mfcc


def onset_peaks(envelope: Floats, rate: int) -> NDArray[np.bool_]:
    """Return which frames of envelopes (W, T) are onsets: local maxima well above the local mean."""
    level = _level(envelope)
    peaks = _clearance(level, rate) >= 0
    peaks &= level.any(axis=1, keepdims=True)
    wait = _n_frames(0.03, rate)
    if wait:
        for window in peaks:
            _leave_out_close_ones(window, wait)
    return np.asarray(peaks)


def onset_margins(envelope: Floats, rate: int) -> NDArray[np.float64]:
    """Return the dB by which the frames of each envelope (W, T) may change without changing its onsets; (W,).

    A change of e moves a level by at most 2 e / span, and so the distance of two levels by 4 e / span.
    """
    level = _level(envelope)
    span = envelope.max(axis=1) - envelope.min(axis=1)
    margins: NDArray[np.float64] = np.abs(_clearance(level, rate)).min(axis=1) * span / 4
    return np.where(span > 0, margins, np.inf)


def _level(envelope: Floats) -> Floats:
    """Scale envelopes (W, T) to 0 .. 1."""
    level: Floats = envelope - envelope.min(axis=1, keepdims=True)
    level /= level.max(axis=1, keepdims=True) + np.finfo(np.float32).tiny
    return level


def _clearance(level: Floats, rate: int) -> NDArray[np.float64]:
    """Return how far levels (W, T) exceed the limit for an onset: the local mean, and the frames before."""
    clearance = level - (_local_mean(level, _n_frames(0.10, rate)) + _DELTA)
    for k in range(1, _n_frames(0.03, rate) + 1):
        clearance[:, k:] = np.minimum(clearance[:, k:], level[:, k:] - level[:, :-k])
    return clearance


def _n_frames(seconds: float, rate: int) -> int:
    return int(seconds * rate // HOP)


def _local_mean(level: Floats, reach: int) -> NDArray[np.float64]:
    """Mean over the existing frames of t - reach .. t + reach; summed in float32, as librosa's kernel does."""
    n_frames = level.shape[1]
    padded = np.pad(level, ((0, 0), (reach, reach)))
    total = np.zeros_like(level)
    for k in range(2 * reach + 1):
        total += padded[:, k : k + n_frames]
    frames = np.arange(n_frames)
    count = np.minimum(frames + reach + 1, n_frames) - np.maximum(frames - reach, 0)
    mean: NDArray[np.float64] = total.astype(np.float64) / count
    return mean


def _leave_out_close_ones(peaks: NDArray[np.bool_], wait: int) -> None:
    """Drop peaks (T,) within `wait` frames after a peak that was kept, from left to right."""
    last = -1 - wait
    for frame in np.flatnonzero(peaks).tolist():
        if frame <= last + wait:
            peaks[frame] = False
        else:
            last = frame


@lru_cache(maxsize=1)
def _dct() -> Floats:
    """Matrix (128, 20) of the orthonormal type-2 cosine transform."""
    k, n = np.arange(N_MFCC), np.arange(N_MELS)
    matrix = np.cos(np.pi / N_MELS * np.outer(n + 0.5, k)) * np.sqrt(2.0 / N_MELS)
    matrix[:, 0] /= np.sqrt(2.0)
    return np.ascontiguousarray(matrix, dtype=np.float32)

"""Tempo and beats of windows: librosa's `tempo` and `beat_track`, vectorised.

Ellis, "Beat tracking by dynamic programming", 2007. The best score up to a frame depends on frames at least half a
beat earlier, so half a beat of frames is computed at once, for all windows. Sums have the order and the precision
(double) of librosa's kernels.
"""

from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from dancedata.audio._settings import HOP
from dancedata.audio.librosa35.arrays import Floats, strided
from dancedata.audio.librosa35.spectra import hann

_Doubles = NDArray[np.float64]
_WINDOW_S = 8.0
_MAX_BPM = 320.0
_FRAMES_AT_ONCE = 256
_MIN_RISE = np.float32(1e-12)
# Bound on the float32 rounding of the mean autocorrelation, which is 1 at lag 0; seen: up to 2e-7.
_FLOAT32_ERROR = 2e-6


def window_beats(envelopes: Floats, tempos: NDArray[np.float64], rate: int, tightness: float) -> NDArray[np.bool_]:
    """Return which frames of envelopes (W, T) are beats, given each window's tempo (W,) in beats per minute."""
    beats = np.zeros(envelopes.shape, dtype=np.bool_)
    audible = np.flatnonzero(envelopes.any(axis=1))
    if not len(audible):
        return beats
    envelopes = envelopes[audible]
    period = np.round(float(rate) / HOP * 60.0 / tempos[audible]).astype(np.int64)
    score = _local_score(envelopes, period)
    links, total = _best_paths(score, period, np.float64(np.float32(tightness)))
    last = _last_beats(total)
    for k, window in enumerate(audible):
        path = _path(links[k].tolist(), int(last[k]))
        beats[window, path] = True
        _trim(score[k], beats[window])
    return beats


def _local_score(envelopes: Floats, period: NDArray[np.int64]) -> _Doubles:
    """Smooth envelopes of unit deviation by a Gaussian of 1/32 beat; (W, T)."""
    deviation = envelopes.std(axis=1, ddof=1, keepdims=True)
    onsets = envelopes / (deviation + np.finfo(np.float32).tiny)
    # librosa's convolution stops short of the first frame.
    onsets[:, 0] = 0
    reach, n_frames = int(period.max()), onsets.shape[1]
    padded = np.pad(onsets.astype(np.float64), ((0, 0), (reach, reach)))
    score = np.zeros(onsets.shape)
    offsets = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offsets * 32.0 / period[:, np.newaxis]) ** 2)
    weights[np.abs(offsets) > period[:, np.newaxis]] = 0
    for k, offset in enumerate(offsets.tolist()):
        start = reach - offset
        score += weights[:, k, np.newaxis] * padded[:, start : start + n_frames]
    return score


def _best_paths(score: _Doubles, period: NDArray[np.int64], tightness: float) -> tuple[NDArray[np.int64], _Doubles]:
    """Return for each frame (W, T) the previous beat, or -1, and the score of the best path that ends at it."""
    n_windows, n_frames = score.shape
    # A beat is half a period to two periods after the previous one; halves round to even.
    nearest, farthest = np.round(period / 2).astype(np.int64), 2 * period
    low, high = max(1, int(nearest.min())), int(farthest.max())
    penalty = _penalty(np.arange(low, high + 1), period, nearest, farthest, tightness)
    # Frames before the first one have no score.
    padded = np.full((n_windows, high + n_frames), -np.inf)
    links = np.full((n_windows, n_frames), -1)
    total = np.empty_like(score)
    # For frame t, totals of t - low, t - low - 1, ..., t - high.
    before = sliding_window_view(padded, high - low + 1, axis=1)[:, :, ::-1]
    for first in range(0, n_frames, low):
        frames = slice(first, min(first + low, n_frames))
        candidates = before[:, frames] - penalty[:, np.newaxis]
        lag = candidates.argmax(axis=2)
        best = candidates.max(axis=2)
        linked = best > -np.inf
        total[:, frames] = np.where(linked, score[:, frames] + best, score[:, frames])
        links[:, frames] = np.where(linked, np.arange(n_frames)[frames] - low - lag, -1)
        padded[:, high + first : high + first + low] = total[:, frames]
    # The first beat must be loud enough: no links before it.
    loud = score >= 0.01 * score.max(axis=1, keepdims=True)
    links[np.arange(n_frames) < loud.argmax(axis=1)[:, np.newaxis]] = -1
    return links, total


def _penalty(
    lags: NDArray[np.int64],
    period: NDArray[np.int64],
    nearest: NDArray[np.int64],
    farthest: NDArray[np.int64],
    tightness: float,
) -> NDArray[np.float64]:
    """Cost (W, L) of a beat `lags` frames after the previous one; infinite where that is not allowed."""
    deviation = np.log(lags.astype(np.float64)) - np.log(period.astype(np.float64))[:, np.newaxis]
    possible = (lags >= nearest[:, np.newaxis]) & (lags <= farthest[:, np.newaxis])
    return np.where(possible, tightness * (deviation * deviation), np.inf)


def _last_beats(total: _Doubles) -> NDArray[np.int64]:
    """Return the last local maximum of each path score that is at least half the median of its maxima."""
    n_frames = total.shape[1]
    peak = np.zeros(total.shape, dtype=np.bool_)
    peak[:, 1:-1] = (total[:, 1:-1] > total[:, :-2]) & (total[:, 1:-1] >= total[:, 2:])
    peak[:, -1] = total[:, -1] > total[:, -2]
    count = peak.sum(axis=1)
    ascending = np.sort(np.where(peak, total, np.inf), axis=1)
    middle = np.stack([np.maximum(count - 1, 0) // 2, count // 2], axis=1)
    middle = np.minimum(middle, n_frames - 1)
    low, high = np.take_along_axis(ascending, middle, axis=1).T
    threshold = 0.5 * ((low + high) / 2)
    candidate = peak & (total >= threshold[:, np.newaxis])
    last: NDArray[np.int64] = n_frames - 1 - candidate[:, ::-1].argmax(axis=1)
    return last


def _path(links: list[int], last: int) -> list[int]:
    path = []
    while last >= 0:
        path.append(last)
        last = links[last]
    return path


def _trim(score: _Doubles, beats: NDArray[np.bool_]) -> None:
    """Drop beats before the first, and after the last, frame whose score is above half the beats' RMS."""
    strengths = np.convolve(score[beats], [0.0, 0.5, 1.0, 0.5, 0.0])[2 : len(score) + 2]
    strong = score > 0.5 * np.sqrt(strengths @ strengths / len(strengths))
    first, last = int(strong.argmax()), len(strong) - int(strong[::-1].argmax())
    if not strong[first]:
        first = last
    beats[:first] = False
    beats[last:] = False


def window_tempos(envelopes: Floats, rate: int, start_bpm: float) -> NDArray[np.float64]:
    """Return the most likely tempo around `start_bpm` of each envelope (W, T), in beats per minute.

    The autocorrelation of eight seconds around every frame, scaled to 1 at lag 0, is averaged over frames and
    weighted by how far each lag's tempo is from the expected one. The transform back to lags is linear, so only the
    mean of power spectra is transformed back. This is done in float32, and again in double precision
    where the two best tempos are closer than the rounding error.
    """
    tempos, log_prior = _tempos_and_prior(rate, start_bpm)
    single = _mean_autocorrelations(envelopes, len(tempos), np.dtype(np.float32))
    score = _score(single, log_prior)
    best = score.argmax(axis=1)
    for window in np.flatnonzero(_is_close(score, best, single) | _is_too_faint(envelopes)):
        double = _mean_autocorrelations(envelopes[[window]], len(tempos), np.dtype(np.float64))
        best[window] = _score(double, log_prior)[0].argmax()
    best_tempos: NDArray[np.float64] = tempos[best]
    return best_tempos


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
    # Envelopes are not negative, so a value below zero is a rounding error.
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

"""One STFT for all columns: rows of mel spectrum in dB and of spectral peaks, shared by the windows of a track.

A row whose frame is within a window, clear of its ends, is the track's row. The few rows at each end, whose frames
include the zeros beyond the window, are computed per window.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._settings import HOP
from dancedata.audio.librosa35.arrays import Floats, strided
from dancedata.audio.librosa35.tuning import Peaks, find_peaks
from dancedata.audio.librosa35.windows import Windows

N_FFT = 2048
N_MFCC = 20
TOP_DB = np.float32(80.0)
# Frame 0 has no frame before it, and the envelope is moved by half an STFT frame.
LAG = 1 + N_FFT // (2 * HOP)
_DELTA = np.float64(np.float32(0.07))


def envelope_and_mfcc(db: Floats, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Compute the onset envelopes (W, T) and MFCC (W, T, 20) of windows, `rows` (W, T) of `db` (R, 128)."""
    n_windows, n_frames = rows.shape
    envelope = np.zeros((n_windows, n_frames), dtype=np.float32)
    mfcc = np.empty((n_windows, n_frames, N_MFCC), dtype=np.float32)
    for window, frames in enumerate(rows):
        limited = db[frames]
        np.maximum(limited, limited.max() - TOP_DB, out=limited)
        # A constant affects coefficient 0 only, and smaller numbers lose less to rounding.
        floor = limited.min()
        mfcc[window] = (limited - floor) @ _dct()
        mfcc[window, :, 0] += floor * np.float32(np.sqrt(_N_MELS))
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
    k, n = np.arange(N_MFCC), np.arange(_N_MELS)
    matrix = np.cos(np.pi / _N_MELS * np.outer(n + 0.5, k)) * np.sqrt(2.0 / _N_MELS)
    matrix[:, 0] /= np.sqrt(2.0)
    return np.ascontiguousarray(matrix, dtype=np.float32)


_N_MELS = 128
# Power that librosa treats as silence: -100 dB.
_MIN_POWER = np.float32(1e-10)
# Frames at once: with their spectra they fit into the processor's cache.
_BLOCK = 64


@dataclass(frozen=True)
class Spectra:
    """Rows of all windows of a track: mel spectrum in dB (R, 128), at least -100, and spectral peaks.

    `rows`: (W, T) row of frame t of window w.
    """

    db: Floats
    peaks: Peaks
    rows: NDArray[np.int64]


def window_spectra(windows: Windows, rate: int) -> Spectra:
    """Compute the rows of all windows; their starts are multiples of `HOP`."""
    n_frames = 1 + windows.length // HOP
    rows = windows.starts[:, np.newaxis] // HOP + np.arange(n_frames)
    if windows.is_whole:
        everything = np.arange(n_frames)
        return Spectra(*_mel_and_peaks(_track_blocks(windows.track, everything), n_frames, rate), rows)
    n_head = -(-(N_FFT // 2 + windows.end) // HOP)
    first_tail = (windows.length - windows.end - N_FFT // 2) // HOP + 1
    n_tail = n_frames - first_tail
    used = np.unique(rows[:, n_head:first_tail])
    heads = _frames(windows.head(N_FFT // 2 + HOP * (n_head - 1)), N_FFT // 2, n_head)
    tails = _frames(windows.tail(windows.length + N_FFT // 2 - first_tail * HOP), 0, n_tail)
    n_shared, n_own = len(used), len(rows) * (n_head + n_tail)
    edge_rows = n_shared + np.arange(n_own).reshape(len(rows), -1)
    rows[:, n_head:first_tail] = np.searchsorted(used, rows[:, n_head:first_tail])
    rows[:, :n_head], rows[:, first_tail:] = edge_rows[:, :n_head], edge_rows[:, n_head:]
    blocks = chain(_track_blocks(windows.track, used), _own_blocks(heads, tails))
    return Spectra(*_mel_and_peaks(blocks, n_shared + n_own, rate), rows)


def mel_db(samples: Floats, rate: int) -> Floats:
    """Return the mel spectrum (T, 128) of a signal in dB, at least -100, without an upper limit."""
    return window_spectra(Windows.whole(samples), rate).db


def _mel_and_peaks(
    blocks: Iterable[tuple[Floats, NDArray[np.int64]]], n_rows: int, rate: int
) -> tuple[Floats, Peaks]:
    """Transform frames, given as stacks of blocks (b, n, 2048) with the numbers of the frames to keep."""
    import scipy.fft

    filters = mel_filters(rate)
    db = np.empty((n_rows, _N_MELS), dtype=np.float32)
    peaks, done = [], 0
    for stack, kept in blocks:
        power = np.empty((*stack.shape[:2], N_FFT // 2 + 1), dtype=np.float32)
        for frames, row_power in zip(stack, power, strict=True):
            spectrum = scipy.fft.rfft(frames, axis=1, overwrite_x=True)
            np.square(spectrum.real, out=row_power)
            row_power += np.square(spectrum.imag)
        db[done : done + len(kept)] = np.matmul(power, filters).reshape(-1, _N_MELS)[kept]
        peaks.append(find_peaks(power.reshape(-1, N_FFT // 2 + 1)[kept], rate, is_power=True))
        done += len(kept)
    np.maximum(db, _MIN_POWER, out=db)
    np.log10(db, out=db)
    db *= np.float32(10.0)
    return db, Peaks.concatenated(peaks)


def _frames(samples: Floats, lead: int, count: int) -> Floats:
    """Return frames (W, count, 2048) of signals (W, n), a view; frame 0 begins `lead` samples before the signal."""
    n_signals, n_samples = samples.shape
    needed = max(lead + n_samples, (count - 1) * HOP + N_FFT)
    padded = np.zeros((n_signals, needed), dtype=np.float32)
    padded[:, lead : lead + n_samples] = samples
    return strided(padded, (n_signals, count, N_FFT), (needed, HOP, 1))


def _track_blocks(track: Floats, used: NDArray[np.int64]) -> Iterator[tuple[Floats, NDArray[np.int64]]]:
    """Yield windowed frames of a track, in separate memory, in blocks on a grid from its beginning.

    Blocks are always whole, so that the numbers of a frame do not depend on which frames are used.
    """
    n_blocks = -(-(int(used[-1]) + 1) // _BLOCK)
    frames = _frames(track[np.newaxis], N_FFT // 2, n_blocks * _BLOCK).reshape(n_blocks, _BLOCK, N_FFT)
    window = hann(N_FFT).astype(np.float32)
    for block in np.unique(used // _BLOCK):
        yield frames[block : block + 1] * window, used[used // _BLOCK == block] - block * _BLOCK


def _own_blocks(heads: Floats, tails: Floats) -> Iterator[tuple[Floats, NDArray[np.int64]]]:
    """Yield the windowed frames at the ends of windows, (W, n, 2048), one block per window, some windows at once."""
    window = hann(N_FFT).astype(np.float32)
    n_frames = heads.shape[1] + tails.shape[1]
    at_once = -(-_BLOCK // n_frames)
    for first in range(0, len(heads), at_once):
        part = slice(first, first + at_once)
        stack = np.concatenate([heads[part], tails[part]], axis=1) * window
        yield stack, np.arange(len(stack) * n_frames)


def hann(length: int) -> NDArray[np.float64]:
    """Hann window as scipy gives it for spectra (periodic), bit for bit."""
    window: NDArray[np.float64] = 0.5 + 0.5 * np.cos(np.linspace(-np.pi, np.pi, length + 1))[:-1]
    return window


@lru_cache(maxsize=8)
def mel_filters(rate: int) -> Floats:
    """Slaney's mel filter bank (1025, 128) of librosa, transposed: 0 Hz to half the rate, equal area."""
    edges_hz = _mel_frequencies(rate / 2, _N_MELS + 2)
    widths = np.diff(edges_hz)
    ramps = np.subtract.outer(edges_hz, np.fft.rfftfreq(N_FFT, 1.0 / rate))
    weights = np.zeros((_N_MELS, N_FFT // 2 + 1), dtype=np.float32)
    weights[:] = np.maximum(0, np.minimum(-ramps[:-2] / widths[:-1, np.newaxis], ramps[2:] / widths[1:, np.newaxis]))
    weights *= (2.0 / (edges_hz[2:] - edges_hz[:-2]))[:, np.newaxis]
    return np.ascontiguousarray(weights.T)


def _mel_frequencies(top_hz: float, count: int) -> NDArray[np.float64]:
    """Frequencies at equal distances in mel: linear up to 1 kHz, logarithmic above (Slaney's Auditory Toolbox)."""
    hz_per_mel, break_hz = 200.0 / 3, 1000.0
    break_mel, log_step = break_hz / hz_per_mel, np.log(6.4) / 27.0
    top_mel = break_mel + np.log(top_hz / break_hz) / log_step
    mels = np.linspace(0.0, top_mel, count)
    above = break_hz * np.exp(log_step * (mels - break_mel))
    frequencies: NDArray[np.float64] = np.where(mels >= break_mel, above, hz_per_mel * mels)
    return frequencies

"""One STFT for everything: rows of mel spectrum in dB and of spectral peaks, shared by the windows of a track.

A row whose frame lies within a window, clear of its ends, is the track's row. The few at either end, which see
the zeros beyond the window, are computed for each window.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._fast_arrays import Floats, strided, times
from dancedata.audio._fast_tuning import Peaks, find_peaks
from dancedata.audio._fast_windows import Windows

HOP = 512
N_FFT = 2048
N_MELS = 128
# Power that librosa takes for silence: -100 dB.
_MIN_POWER = np.float32(1e-10)
# Frames at a time: with their spectra they stay in the processor's cache.
_BLOCK = 64


@dataclass(frozen=True)
class Spectra:
    """Rows of all windows of a track.

    Attributes
    ----------
    db
        (R, 128) mel spectrum in dB, at least -100, not limited to the upper 80 dB of a window yet.
    peaks
        Spectral peaks of the R rows.
    rows
        (W, T) which row is frame t of window w.
    """

    db: Floats
    peaks: Peaks
    rows: NDArray[np.int64]


def window_spectra(windows: Windows, rate: int) -> Spectra:
    """Compute the rows of all windows; their starts are multiples of `HOP`."""
    n_frames = 1 + windows.length // HOP
    rows = windows.starts[:, np.newaxis] // HOP + np.arange(n_frames)
    if windows.is_whole:
        frames = _frames(windows.track[np.newaxis], N_FFT // 2, n_frames)[0]
        return Spectra(*_mel_and_peaks(_blocks(frames), n_frames, rate), rows)
    n_head = -(-(N_FFT // 2 + windows.end) // HOP)
    first_tail = (windows.length - windows.end - N_FFT // 2) // HOP + 1
    used = np.unique(rows[:, n_head:first_tail])
    heads = _frames(windows.head(N_FFT // 2 + HOP * (n_head - 1)), N_FFT // 2, n_head)
    tail = windows.tail(windows.length + N_FFT // 2 - first_tail * HOP)
    tails = _frames(tail, 0, n_frames - first_tail)

    def blocks() -> Iterator[Floats]:
        yield from _blocks(_frames(windows.track[np.newaxis], N_FFT // 2, int(used[-1]) + 1)[0], used)
        yield from _blocks(heads.reshape(-1, N_FFT))
        yield from _blocks(tails.reshape(-1, N_FFT))

    n_shared, n_edge = len(used), heads.shape[0] * heads.shape[1]
    rows[:, n_head:first_tail] = np.searchsorted(used, rows[:, n_head:first_tail])
    rows[:, :n_head] = n_shared + np.arange(n_edge).reshape(heads.shape[:2])
    rows[:, first_tail:] = n_shared + n_edge + np.arange(rows[:, first_tail:].size).reshape(tails.shape[:2])
    n_rows = n_shared + n_edge + tails.shape[0] * tails.shape[1]
    return Spectra(*_mel_and_peaks(blocks(), n_rows, rate), rows)


def mel_db(samples: Floats, rate: int) -> Floats:
    """Return the mel spectrum (T, 128) of a signal in dB, at least -100, without an upper limit."""
    return window_spectra(Windows.whole(samples), rate).db


def _mel_and_peaks(blocks: Iterator[Floats], n_rows: int, rate: int) -> tuple[Floats, Peaks]:
    """Transform frames, given block by block, (n, 2048) each."""
    import scipy.fft

    filters = mel_filters(rate)
    db = np.empty((n_rows, N_MELS), dtype=np.float32)
    peaks, done = [], 0
    for frames in blocks:
        spectrum = scipy.fft.rfft(frames, axis=1, overwrite_x=True)
        power = np.square(spectrum.real)
        power += np.square(spectrum.imag)
        db[done : done + len(frames)] = times(power, filters, _BLOCK)
        peaks.append(find_peaks(power, rate, is_power=True))
        done += len(frames)
    np.maximum(db, _MIN_POWER, out=db)
    np.log10(db, out=db)
    db *= np.float32(10.0)
    return db, Peaks.concatenated(peaks)


def _frames(samples: Floats, lead: int, count: int) -> Floats:
    """Return frames (W, count, 2048) of signals (W, n), a view; frame 0 begins `lead` samples before them."""
    n_signals, n_samples = samples.shape
    needed = max(lead + n_samples, (count - 1) * HOP + N_FFT)
    padded = np.zeros((n_signals, needed), dtype=np.float32)
    padded[:, lead : lead + n_samples] = samples
    return strided(padded, (n_signals, count, N_FFT), (needed, HOP, 1))


def _blocks(frames: Floats, used: NDArray[np.int64] | None = None) -> Iterator[Floats]:
    """Yield the frames (or those used), under a Hann window, a block at a time, each in fresh memory."""
    window = hann(N_FFT).astype(np.float32)
    count = len(frames) if used is None else len(used)
    for start in range(0, count, _BLOCK):
        part = slice(start, start + _BLOCK)
        yield (frames[part] if used is None else frames[used[part]]) * window


def hann(length: int) -> NDArray[np.float64]:
    """Hann window as scipy gives it for spectra (periodic), bit for bit."""
    window: NDArray[np.float64] = 0.5 + 0.5 * np.cos(np.linspace(-np.pi, np.pi, length + 1))[:-1]
    return window


@lru_cache(maxsize=8)
def mel_filters(rate: int) -> Floats:
    """Slaney's mel filter bank (1025, 128) of librosa, transposed: 0 Hz to half the rate, equal area."""
    edges_hz = _mel_frequencies(rate / 2, N_MELS + 2)
    widths = np.diff(edges_hz)
    ramps = np.subtract.outer(edges_hz, np.fft.rfftfreq(N_FFT, 1.0 / rate))
    weights = np.zeros((N_MELS, N_FFT // 2 + 1), dtype=np.float32)
    weights[:] = np.maximum(0, np.minimum(-ramps[:-2] / widths[:-1, np.newaxis], ramps[2:] / widths[1:, np.newaxis]))
    weights *= (2.0 / (edges_hz[2:] - edges_hz[:-2]))[:, np.newaxis]
    return np.ascontiguousarray(weights.T)


def _mel_frequencies(top_hz: float, count: int) -> NDArray[np.float64]:
    """Frequencies at equal distances in mel: linear up to 1 kHz, logarithmic above (Slaney's Auditory Toolbox)."""
    hz_a_mel, break_hz = 200.0 / 3, 1000.0
    break_mel, log_step = break_hz / hz_a_mel, np.log(6.4) / 27.0
    top_mel = break_mel + np.log(top_hz / break_hz) / log_step
    mels = np.linspace(0.0, top_mel, count)
    above = break_hz * np.exp(log_step * (mels - break_mel))
    frequencies: NDArray[np.float64] = np.where(mels >= break_mel, above, hz_a_mel * mels)
    return frequencies

"""Near-ties, decided as librosa decides them.

CENS quantises: a share of 0.1 counts, one just below does not. The tuning is the highest bar of a histogram of
spectral peaks. An onset must exceed the mean around it, and its neighbour. Magnitudes here and in librosa differ by
their rounding, some 1e-7. So in one window of a hundred a value is so close to a step that the two versions may fall
on different sides of it; and the spectrum of a click is so flat that rounding alone makes its peaks. Those windows
are computed again from their own resampled samples, by librosa's steps in its order and precisions, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.librosa35.arrays import Floats, strided
from dancedata.audio.librosa35.chroma import STEPS, shares_of
from dancedata.audio.librosa35.filters import N_OCTAVES, sparse_filters
from dancedata.audio.librosa35.onset import LAG, TOP_DB, onset_margins, onset_peaks
from dancedata.audio.librosa35.resample import halved
from dancedata.audio.librosa35.settings import HOP
from dancedata.audio.librosa35.spectra import N_FFT, hann, mel_filters
from dancedata.audio.librosa35.tuning import BINS_PER_OCTAVE, Peaks, find_peaks, window_tuning

# Largest difference of a share, where a frame is loud (seen: 3.3e-7), and as a part of the window's largest sample
# over the frame's loudness (seen: 2.4e-5): a loud sound without pitch, such as an offset or a tone below the lowest
# filter, is rounded as any other sound is.
_ROUNDING, _NOISE = 4e-7, 3e-5
# Largest difference of an envelope, in dB; seen: 1.1e-4, where all bands but one are 50 to 80 dB below it.
_ENVELOPE_ERROR = 3e-4
_FRAMES_AT_ONCE = 64


def near_ties(chroma: Floats, largest: Floats) -> NDArray[np.bool_]:
    """Return in which frames of chroma (W, T, 12) a share is within rounding of a step; (W, T).

    Parameters
    ----------
    largest
        (W,) largest magnitude of each window's samples.
    """
    loudness = chroma.sum(axis=2)
    relative = largest[:, np.newaxis] / np.maximum(loudness, np.finfo(np.float32).tiny)
    tolerance = np.maximum(_ROUNDING, _NOISE * relative)
    near = np.zeros(loudness.shape, dtype=np.bool_)
    shares = shares_of(chroma)
    for step in STEPS:
        near |= (np.abs(shares - np.float32(step)) < tolerance[..., np.newaxis]).any(axis=2)
    # Magnitudes too small to be squared count as zero here, and all frames of a silent window do.
    return np.asarray(near & (largest > 0)[:, np.newaxis])


def decided_onsets(envelope: Floats, rate: int, samples_of: Callable[[int], Floats]) -> NDArray[np.bool_]:
    """Return which frames of envelopes (W, T) are onsets; where rounding matters, librosa's envelope decides.

    `samples_of` is as for `decide_near_ties`.
    """
    peaks = onset_peaks(envelope, rate)
    for window in np.flatnonzero(onset_margins(envelope, rate) < _ENVELOPE_ERROR).tolist():
        peaks[window] = onset_peaks(librosa_envelope(samples_of(window), rate)[np.newaxis], rate)[0]
    return peaks


def librosa_envelope(samples: Floats, rate: int) -> Floats:
    """Return librosa's `onset_strength` (T,) of a signal (n,)."""
    power = np.concatenate([np.abs(spectrum) ** 2.0 for spectrum in _librosa_spectra(samples)])
    mel = np.einsum("...ft,mf->...mt", power.T, mel_filters(rate).T, optimize=True)
    db = 10.0 * np.log10(np.maximum(1e-10, mel))
    db = np.maximum(db, db.max() - TOP_DB)
    envelope = np.zeros(db.shape[1], dtype=np.float32)
    envelope[LAG:] = np.maximum(0.0, db[:, 1:] - db[:, :-1]).mean(axis=0)[: len(envelope) - LAG]
    return envelope


def decide_near_ties(
    chroma: Floats, largest: Floats, tunings: Sequence[int], rate: int, samples_of: Callable[[int], Floats]
) -> None:
    """Replace frames of chroma (W, T, 12) in which a share is too close to a step by librosa's.

    Parameters
    ----------
    largest, tunings
        Largest magnitude of each window's samples, and its tuning.
    samples_of
        Returns the samples of a window, resampled by itself.
    """
    near = near_ties(chroma, largest)
    for window in np.flatnonzero(near.any(axis=1)).tolist():
        frames = np.flatnonzero(near[window])
        chroma[window, frames] = librosa_chroma(samples_of(window), frames, tunings[window], rate)


def librosa_chroma(samples: Floats, frames: NDArray[np.int64], tuning: int, rate: int) -> Floats:
    """Return librosa's `chroma_cqt` (F, 12), not normalised, of some frames of a signal.

    Parameters
    ----------
    samples
        (n,) float32 at the features' rate.
    frames
        (F,) indices of frames.
    """
    filters, lengths = sparse_filters(tuning, rate)
    magnitudes = np.zeros((N_OCTAVES * BINS_PER_OCTAVE, 1 + len(samples) // HOP), dtype=np.float32, order="F")
    for octave in range(N_OCTAVES):
        samples = halved(samples) if octave else samples
        response = _response(samples, frames * (HOP >> octave), filters, 2.0**octave)
        bins = slice((N_OCTAVES - 1 - octave) * BINS_PER_OCTAVE, (N_OCTAVES - octave) * BINS_PER_OCTAVE)
        response /= np.sqrt(lengths[bins, np.newaxis])
        magnitudes[bins, frames] = np.abs(response)
    to_chroma = np.roll(np.repeat(np.eye(12, dtype=np.float32), 3, axis=1), -1, axis=1)
    chroma = np.einsum("cf,...ft->...ct", np.tile(to_chroma, N_OCTAVES), magnitudes, optimize=True)
    return np.asarray(chroma[:, frames].T)


def librosa_tuning(samples: Floats, rate: int) -> int:
    """Return librosa's `estimate_tuning` of a signal (n,), as the index of the histogram's bar."""
    peaks = [find_peaks(np.abs(spectrum), rate, is_power=False) for spectrum in _librosa_spectra(samples)]
    return window_tuning(Peaks.concatenated(peaks), np.arange(1 + len(samples) // HOP))[0]


def _librosa_spectra(samples: Floats) -> Iterator[NDArray[np.complex64]]:
    """Yield librosa's `stft` of a signal (n,), several frames at a time, (F, 1025) each."""
    import scipy.fft

    n_frames = 1 + len(samples) // HOP
    padded = np.pad(samples, (N_FFT // 2, N_FFT))
    frames = strided(padded, (n_frames, N_FFT), (HOP, 1))
    window = hann(N_FFT)
    for first in range(0, n_frames, _FRAMES_AT_ONCE):
        yield scipy.fft.rfft(frames[first : first + _FRAMES_AT_ONCE] * window, axis=1).astype(np.complex64)


def _response(samples: Floats, centres: NDArray[np.int64], filters: Any, decimation: float) -> NDArray[np.complex64]:
    """Return the responses (36, F) of filters to frames around samples `centres` (F,)."""
    import scipy.fft

    n_fft = 2 * (filters.shape[1] - 1)
    padded = np.pad(samples, (n_fft // 2, n_fft))
    frames = padded[centres + np.arange(n_fft)[:, np.newaxis]].astype(np.float64)
    spectra = scipy.fft.rfft(frames, axis=0).astype(np.complex64)
    scaled = filters.copy()
    scaled.data *= np.sqrt(np.float64(decimation))
    response: NDArray[np.complex64] = scaled.dot(spectra)
    return response

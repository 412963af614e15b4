"""The constant-Q filters of librosa's chroma, made for one octave and used for all seven.

librosa builds seven banks of 36 filters, one per octave, and halves the sample rate from octave to octave. Its
octaves are exact, and so are the ratios of filter frequency to sample rate: all seven banks are the same, up to
rounding in double precision, and so is the gain after librosa's scaling. One bank is built here, with librosa's
steps and precisions, and turned into a matrix that acts on frames of samples:

- librosa multiplies the frame's spectrum D by the thinned spectrum B of a filter: sum_f B[f] D[f]. That is
  sum_n k[n] x[n] with k the Fourier transform of B.
- Every filter is a cosine and a sine under a symmetric window, times a phase that does not affect the magnitude.
  So k is even (its real part) and odd (its imaginary part) about a point: half a sample after the middle of the
  frame, for all filters. Half the products suffice, on the sums x[m + 1 + j] + x[m - j] of samples at equal
  distances from that point, m = n / 2, and on their differences. The transform is periodic, so the partner of
  x[1] is x[0].
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.librosa35.arrays import Floats
from dancedata.audio.librosa35.spectra import hann
from dancedata.audio.librosa35.tuning import BINS_PER_OCTAVE, N_TUNINGS, tuning_edges

N_OCTAVES = 7
_C1_HZ = 440.0 * 2.0 ** ((24 - 69) / 12)
# librosa drops the weakest spectral values of a filter, which add up to this fraction of the sum.
_DROPPED = 0.01
# A Hann window extends a filter beyond its frequency by half its bandwidth times this factor (librosa).
_HANN_BANDWIDTH = 1.50018310546875


@dataclass(frozen=True)
class FilterBank:
    """Filters of an octave, for frames of `2 * len(even)` samples.

    `even`, `odd`: (n / 2, 36): real parts, for the sums, and imaginary parts, for the differences, of samples at
        equal distances from the point of symmetry, the nearest first.
    """

    even: Floats
    odd: Floats


@lru_cache(maxsize=8)
def has_one_bank(rate: int) -> bool:
    """Return whether librosa's seven banks are the same at this sample rate, for every tuning.

    They agree from 8,300 to about 32,000 Hz: above, librosa lowers the rate first. If the length of a filter were a
    whole number to the last digit, rounding might differ between octaves.
    """
    for tuning in range(N_TUNINGS):
        frequencies, bandwidths = _frequencies(tuning)
        cutoff = float((frequencies * (1 + 0.5 * _HANN_BANDWIDTH * bandwidths)).max())
        if not cutoff <= rate / 2 <= 4 * cutoff:
            return False
        rates = np.repeat(rate / 2.0 ** np.arange(N_OCTAVES)[::-1], BINS_PER_OCTAVE)
        halves = np.floor(_lengths(frequencies, bandwidths, rates) / 2).reshape(N_OCTAVES, BINS_PER_OCTAVE)
        if (halves != halves[-1]).any():
            return False
    return True


@lru_cache(maxsize=4 * N_TUNINGS)
def filter_bank(tuning: int, rate: int) -> FilterBank:
    """Build the bank for a tuning, 0 .. 99, of the top octave at the features' sample rate."""
    spectra, lengths = _spectra(tuning, rate)
    scaled = spectra.astype(np.complex128) / np.sqrt(lengths[-BINS_PER_OCTAVE:, np.newaxis])
    return _in_time(scaled, 2 * (spectra.shape[1] - 1))


@lru_cache(maxsize=4 * N_TUNINGS)
def sparse_filters(tuning: int, rate: int) -> tuple[Any, NDArray[np.float64]]:
    """Return librosa's filters of the top octave, sparse, and the lengths (252,) of all filters in samples."""
    from scipy.sparse import csr_matrix

    spectra, lengths = _spectra(tuning, rate)
    return csr_matrix(spectra), lengths


def _spectra(tuning: int, rate: int) -> tuple[NDArray[np.complex64], NDArray[np.float64]]:
    """Build the thinned spectra (36, n / 2 + 1) of the top octave's filters, and the lengths (252,) of all."""
    import scipy.fft

    frequencies, bandwidths = _frequencies(tuning)
    all_lengths = _lengths(frequencies, bandwidths, rate)
    top = slice(-BINS_PER_OCTAVE, None)
    lengths = all_lengths[top]
    n_fft = int(2.0 ** np.ceil(np.log2(lengths.max())))
    wavelets = np.zeros((BINS_PER_OCTAVE, n_fft), dtype=np.complex64)
    for filter_, frequency, length in zip(wavelets, frequencies[top], lengths, strict=True):
        wavelet = _wavelet(frequency / rate, length)
        start = (n_fft - len(wavelet)) // 2
        filter_[start : start + len(wavelet)] = wavelet
    wavelets *= lengths[:, np.newaxis] / float(n_fft)
    spectra: NDArray[np.complex64] = scipy.fft.fft(wavelets, axis=1)
    return _thinned(spectra[:, : n_fft // 2 + 1]), all_lengths


def _frequencies(tuning: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies (252,) in Hz of all seven octaves and their relative bandwidths (252,)."""
    lowest = _C1_HZ * 2.0 ** (tuning_edges()[tuning] / BINS_PER_OCTAVE)
    octave = 2.0 ** (np.arange(BINS_PER_OCTAVE, dtype=float) / BINS_PER_OCTAVE)
    frequencies = np.multiply.outer(2.0 ** np.arange(float(N_OCTAVES)), octave).ravel() * lowest
    octaves = np.log2(frequencies)
    spacing = np.empty_like(octaves)
    spacing[[0, -1]] = octaves[1] - octaves[0], octaves[-1] - octaves[-2]
    spacing[1:-1] = (octaves[2:] - octaves[:-2]) / 2
    ratio = 2.0 ** (2 * spacing)
    return frequencies, (ratio - 1) / (ratio + 1)


def _lengths(
    frequencies: NDArray[np.float64], bandwidths: NDArray[np.float64], rate: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Lengths of filters in samples: Q periods."""
    lengths: NDArray[np.float64] = (1.0 / bandwidths) * rate / frequencies
    return lengths


def _wavelet(cycles_per_sample: float, length: float) -> NDArray[np.complex128]:
    """Return a windowed complex exponential whose magnitudes add up to 1."""
    phase = np.arange(-length // 2, length // 2, dtype=float) * 2 * np.pi * cycles_per_sample
    wavelet = (np.cos(phase) + 1j * np.sin(phase)) * hann(len(phase))
    scaled: NDArray[np.complex128] = wavelet / np.abs(wavelet).sum()
    return scaled


def _thinned(spectra: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Set the weakest values of each row to zero, as librosa's `sparsify_rows` does."""
    magnitudes = np.abs(spectra)
    ascending = np.sort(magnitudes, axis=1)
    shares = np.cumsum(ascending / magnitudes.sum(axis=1, keepdims=True), axis=1)
    first_kept = np.argmin(shares < _DROPPED, axis=1)
    smallest = np.take_along_axis(ascending, first_kept[:, np.newaxis], axis=1)
    thinned: NDArray[np.complex64] = np.where(magnitudes >= smallest, spectra, np.complex64(0))
    return thinned


def _in_time(spectra: NDArray[np.complex128], n_fft: int) -> FilterBank:
    """Turn responses to spectra (36, n_fft / 2 + 1) into responses to samples, split into even and odd."""
    responses = np.fft.fft(spectra, n=n_fft, axis=1)
    middle = n_fft // 2
    after, before = np.roll(responses, -middle - 1, axis=1)[:, :middle], responses[:, middle:0:-1]
    # The phase that makes them even and odd is that of the sum: odd parts cancel in it.
    phases = np.exp(-1j * np.angle((after + before)[:, :1]))
    even, odd = (after + before) * phases / 2, (after - before) * phases / 2
    return FilterBank(
        np.ascontiguousarray(even.real.T, dtype=np.float32), np.ascontiguousarray(odd.imag.T, dtype=np.float32)
    )

"""Samples of a signal: quantised as in a wav file, resampled as `librosa.load` does, to the bit."""

import math

import numpy as np
from numpy.typing import NDArray


def pcm16(samples: NDArray[np.float32]) -> NDArray[np.float32]:
    """Quantise as writing a 16-bit wav with soundfile and reading it again does.

    libsndfile (with clipping on, as in soundfile) scales to 32 bit, rounds, and keeps the upper 16 bits: that is
    floor(x * 32768), except that a value less than half a 32-bit step below a 16-bit step is rounded up to it.
    EDGE makes its window wavs this way; rounding to nearest instead changes MFCC by up to 0.26.

    `samples`: (n,) float32, full scale 1.
    Returns: (n,) float32, multiples of 1 / 32768 in [-1, 1).
    """
    # Scaling by powers of two is exact in float32; rint rounds halves to even as libsndfile's lrintf does.
    full_scale = np.clip(np.asarray(samples, dtype=np.float32), -1, 1)
    steps = np.floor(np.rint(full_scale * np.float32(2**31)) / np.float32(2**16))
    quantised: NDArray[np.float32] = np.minimum(steps, 32767) / np.float32(32768)
    return quantised


def resample(samples: NDArray[np.float32], from_rate: int, to_rate: int) -> NDArray[np.float32]:
    """Resample as `librosa.load` does: soxr, quality HQ, zeros appended to the length of `resampled_length`.

    `samples`: (n,) float32 at `from_rate`.
    `from_rate`, `to_rate`: Sample rates in Hz.
    Returns: (m,) float32, m = `resampled_length(n, from_rate, to_rate)`; the same array if the rates are equal.
    """
    if from_rate == to_rate:
        return samples
    import soxr  # what librosa calls; importing librosa takes seconds

    output = soxr.resample(samples, from_rate, to_rate, quality="soxr_hq")
    resampled = np.zeros(resampled_length(len(samples), from_rate, to_rate), np.float32)
    resampled[: len(output)] = output[: len(resampled)]
    return resampled


def resampled_length(n_samples: int, from_rate: int, to_rate: int) -> int:
    """Count the samples that `resample` gives: ceil(n * to / from), in librosa's own floating point."""
    if from_rate == to_rate:
        return n_samples
    return math.ceil(n_samples * (float(to_rate) / from_rate))

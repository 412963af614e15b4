"""Resampling of a track, and of the ends of its windows.

A resampler is a filter of finite reach: a sample of its output depends on a few hundred samples of its input.
So the resampled audio of a window, cut out and resampled by itself, equals the resampled track except for one
reach at each end, where the filter has zeros instead of the track as input (up to float32 rounding, 1e-7). As the
filter is linear, an end is the product of a matrix and the window's first or last samples. The matrix holds soxr's
responses to impulses.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.librosa35.arrays import Floats, aligned
from dancedata.core.audio_signal import resampled_length
from dancedata.kernel import resample

# Beyond this many samples, counted at the lower of the two rates, the response of soxr's HQ filter is below
# 1e-7 of its peak (measured: 99 to 103 for every pair of rates tried, up and down).
_REACH = 112
#: Longest period of two rates, in samples of the input, for which responses are tabulated: the table has
#: 3 period^2 floats, 6 MB at 44,100 Hz, 50 MB at this, 26 GB at 47,999 Hz.
MAX_PERIOD = 2048
# Differences above this, at full scale, are not rounding.
_AUDIBLE = 3e-6


def halved(samples: Floats) -> Floats:
    """Halve the rate as librosa's constant-Q transform does: sqrt(2) louder, to keep the energy."""
    output = resample(samples, 2, 1)
    output /= np.sqrt(0.5)
    return output


def filter_radius(from_rate: int, to_rate: int) -> int:
    """Return the number of input samples, before and after, on which an output sample depends."""
    return math.ceil(_REACH * max(1.0, from_rate / to_rate))


def reach_out(from_rate: int, to_rate: int) -> int:
    """Return the number of output samples, before and after, that depend on an input sample."""
    return math.ceil(_REACH * max(1.0, to_rate / from_rate))


def period(from_rate: int, to_rate: int) -> int:
    """Return the number of input samples between two instants that have a sample at both rates."""
    return from_rate // math.gcd(from_rate, to_rate)


@lru_cache(maxsize=16)
def head_matrix(from_rate: int, to_rate: int, n_input: int, n_output: int) -> Floats:
    """Return the matrix that turns the first samples of a signal into its first resampled samples.

    The first 2 to 76, depending on the rates, differ from those of a signal with zeros before it: soxr chains several
    filters, and the second one starts without the output that the first one would give before time zero. Halving the
    rate takes a single filter and has no such beginning.
    """
    matrix = _matrix(from_rate, to_rate, n_input, 0, n_output)
    if (from_rate, to_rate) != (2, 1):
        beginning = _beginning(from_rate, to_rate)
        matrix[:, : beginning.shape[1]] = 0
        matrix[: len(beginning), : beginning.shape[1]] = beginning
    return aligned(matrix)


@lru_cache(maxsize=16)
def tail_matrix(from_rate: int, to_rate: int, n_input: int, n_output: int) -> Floats:
    """Return the matrix that turns the last samples of a signal into its last resampled samples."""
    import soxr

    total = resampled_length(n_input, from_rate, to_rate)
    matrix = _matrix(from_rate, to_rate, n_input, total - n_output, n_output)
    # soxr rounds the length, librosa rounds it up and appends a zero.
    n_made = len(soxr.resample(np.zeros(n_input, dtype=np.float32), from_rate, to_rate, quality="soxr_hq"))
    matrix[:, n_output - max(0, total - n_made) :] = 0
    return aligned(matrix)


def _matrix(from_rate: int, to_rate: int, n_input: int, first: int, n_output: int) -> Floats:
    """Return responses (n_input, n_output) of output samples first, first + 1, ... to input samples 0, 1, ..."""
    table = _responses(from_rate, to_rate)
    reach = reach_out(from_rate, to_rate)
    step_in = period(from_rate, to_rate)
    step_out = step_in * to_rate // from_rate
    steps, phase = np.divmod(np.arange(n_input), step_in)
    output = first + np.arange(n_output) - (steps * step_out)[:, np.newaxis] + reach
    inside = (output >= 0) & (output < table.shape[1])
    matrix: Floats = np.where(inside, table[phase[:, np.newaxis], np.where(inside, output, 0)], np.float32(0))
    return matrix


@lru_cache(maxsize=4)
def _responses(from_rate: int, to_rate: int) -> Floats:
    """Return soxr's response to an impulse at each sample of a period, (period, 2 reach + its output samples)."""
    step_in, reach = period(from_rate, to_rate), reach_out(from_rate, to_rate)
    step_out = step_in * to_rate // from_rate
    periods = 1 + math.ceil((2 * reach + step_out) / step_out)
    slot_in, slot_out = periods * step_in, periods * step_out
    impulses = np.zeros((step_in + 2, slot_in), dtype=np.float32)
    impulses[1 + np.arange(step_in), np.arange(step_in)] = 1.0
    output = resample(impulses.reshape(-1), from_rate, to_rate)
    at = slot_out * (1 + np.arange(step_in))[:, np.newaxis] + np.arange(-reach, step_out + reach)
    table: NDArray[np.float32] = output[at]
    return table


@lru_cache(maxsize=4)
def _beginning(from_rate: int, to_rate: int) -> Floats:
    """Return the matrix (n, m) that makes a resampled signal's first samples: one soxr channel per impulse."""
    import soxr

    n_output = _n_beginning(from_rate, to_rate)
    n_input = math.ceil((n_output + reach_out(from_rate, to_rate)) * from_rate / to_rate)
    responses = soxr.resample(np.eye(n_input, dtype=np.float32), from_rate, to_rate, quality="soxr_hq")
    beginning: Floats = responses[:n_output].T
    return beginning


def _n_beginning(from_rate: int, to_rate: int) -> int:
    """Count the first samples of a resampled signal that zeros before the signal would change."""
    step_in = period(from_rate, to_rate)
    n_zeros = -(-2 * filter_radius(from_rate, to_rate) // step_in) * step_in
    n_lost = n_zeros * to_rate // from_rate
    last = 0
    for seed in range(4):
        signal = np.random.default_rng(seed).choice(np.array([-1, 1], dtype=np.float32), n_zeros)
        after_zeros = resample(np.concatenate([np.zeros_like(signal), signal]), from_rate, to_rate)
        near = slice(0, reach_out(from_rate, to_rate))
        difference = np.abs(after_zeros[n_lost:][near] - resample(signal, from_rate, to_rate)[near])
        last = max(last, int(np.max(np.flatnonzero(difference > _AUDIBLE), initial=0)))
    return last + 4

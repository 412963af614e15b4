"""Resampling from codes to frames: Fourier resampling as a fixed matrix."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray


def n_frames(n_codes: int, fps: float | Fraction, code_rate: float | Fraction) -> int:
    """Return the number of frames of n_codes codes: ceil(n * fps / rate), in librosa's own floating point."""
    return math.ceil(n_codes * (float(fps) / float(code_rate)))


def resampling_matrix(n_in: int, n_out: int) -> NDArray[np.float32]:
    """Return the matrix R of scipy.signal.resample along time: R @ x resamples x (n_in, D) to (n_out, D).

    It keeps the lowest n_out // 2 + 1 bins of the real Fourier transform and transforms back at the new length. The
    clip is treated as periodic, so its ends ring into each other, as in the reference's features.

    Returns
    -------
    NDArray[np.float32]
        (n_out, n_in).
    """
    shorter = min(n_in, n_out)
    k = np.arange(shorter // 2 + 1)
    # Bin k stands for +k and -k, except the last bin of an even length; scipy doubles it when downsampling.
    weight = np.where(k == 0, 1.0, 2.0)
    if shorter % 2 == 0 and n_out >= n_in:
        weight[-1] = 1.0
    # k m mod n before the division: exact phases, however long the clip.
    phase_out = 2 * np.pi * (np.outer(np.arange(n_out), k) % n_out) / n_out
    phase_in = 2 * np.pi * (np.outer(k, np.arange(n_in)) % n_in) / n_in
    matrix = (np.cos(phase_out) * weight) @ np.cos(phase_in) + (np.sin(phase_out) * weight) @ np.sin(phase_in)
    result: NDArray[np.float32] = (matrix / n_in).astype(np.float32)
    return result

"""Samples of a signal, resampled as `librosa.load` does, to the bit."""

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import resampled_length


def resample(samples: NDArray[np.float32], from_rate: int, to_rate: int) -> NDArray[np.float32]:
    """Resample (n,) as `librosa.load` does: soxr, quality HQ, zeros appended to the length of `resampled_length`."""
    if from_rate == to_rate:
        return samples
    import soxr  # what librosa calls; importing librosa takes seconds

    output = soxr.resample(samples, from_rate, to_rate, quality="soxr_hq")
    resampled = np.zeros(resampled_length(len(samples), from_rate, to_rate), np.float32)
    resampled[: len(output)] = output[: len(resampled)]
    return resampled

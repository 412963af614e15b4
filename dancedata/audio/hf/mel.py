"""Log-mel spectrograms as networks were trained on them, a block of a signal at a time."""

from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from dancedata.audio.hf.families.base import Samples

_HOP, _FIELD, _FFT = 160, 400, 512
#: Frames at once: their spectra in double precision are a few MB.
_BLOCK = 2048
_FLOOR = 1.192092955078125e-07
_PREEMPHASIS = 0.97


def kaldi_log_mel(
    samples: Samples, sample_rate: int, *, n_bins: int, window: Literal["povey", "hann"]
) -> npt.NDArray[np.float32]:
    """Compute Kaldi's log-mel filter banks of samples (n,), from 20 Hz to half the sample rate.

    Frames of 400 samples every 160, each with its own mean taken off. As the numpy extractors of transformers for
    w2v-BERT and AST; without torchaudio, whose presence changes what those compute.
    """
    n_frames = max(0, (len(samples) - _FIELD) // _HOP + 1)
    mel = np.empty((n_frames, n_bins), np.float32)
    shape = np.hanning(_FIELD) ** (0.85 if window == "povey" else 1)
    filters = _filters(n_bins, sample_rate)
    for begin in range(0, n_frames, _BLOCK):
        end = min(begin + _BLOCK, n_frames)
        part = samples[begin * _HOP : (end - 1) * _HOP + _FIELD].astype(np.float64)
        frames = np.lib.stride_tricks.sliding_window_view(part, _FIELD)[::_HOP].copy()
        frames -= frames.mean(axis=1, keepdims=True)
        frames[:, 1:] -= _PREEMPHASIS * frames[:, :-1].copy()
        frames[:, 0] *= 1 - _PREEMPHASIS
        spectrum = np.fft.rfft(frames * shape, _FFT).astype(np.complex64)
        power = np.abs(spectrum, dtype=np.float64) ** 2
        mel[begin:end] = np.log(np.maximum(power @ filters, _FLOOR))
    return mel


@lru_cache(maxsize=4)
def _filters(n_bins: int, sample_rate: int) -> npt.NDArray[np.float64]:
    from transformers.audio_utils import mel_filter_bank

    filters: npt.NDArray[np.float64] = mel_filter_bank(
        num_frequency_bins=_FFT // 2 + 1,
        num_mel_filters=n_bins,
        min_frequency=20,
        max_frequency=sample_rate // 2,
        sampling_rate=sample_rate,
        norm=None,
        mel_scale="kaldi",
        triangularize_in_mel_space=True,
    )
    return filters

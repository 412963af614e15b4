"""The log-mel spectrum that the network of Beat This! reads.

Foscarin, Schlueter, Widmer, "Beat this! Accurate beat tracking without DBN postprocessing" (ISMIR 2024), section 3.1;
the numbers are those of the package beat_this 1.1 (`LogMelSpect`), without torchaudio.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch

SAMPLE_RATE, HOP, N_FFT, N_BANDS = 22050, 441, 1024, 128
_LOWEST_HZ, _HIGHEST_HZ = 30.0, 11000.0
_GAIN = 1000.0
#: Fewer samples cannot be continued by their mirror image.
MIN_SAMPLES = N_FFT // 2 + 1


def log_mel(samples: torch.Tensor) -> torch.Tensor:
    """Return the spectrum (1 + n // 441, 128) of samples (n,) float32 at 22,050 Hz, n >= `MIN_SAMPLES`.

    Frame t is centred on t / 50 s; the ends are continued by their mirror image. log(1 + 1000 x) of magnitudes, which
    are divided by the root of the frame's length.
    """
    spectrum = torch.stft(
        samples,
        N_FFT,
        hop_length=HOP,
        window=torch.hann_window(N_FFT, device=samples.device),
        center=True,
        pad_mode="reflect",
        normalized=True,
        return_complex=True,
    )
    bands = _filters().to(samples.device) @ spectrum.abs()
    return torch.log1p(_GAIN * bands).T


@lru_cache(maxsize=1)
def _filters() -> torch.Tensor:
    """Return the triangular filters (128, 513) on Slaney's mel scale, each 1 at its top.

    In float32, as those of the training were: where music is quiet, the logarithm shows their last digits.
    """
    bins = torch.linspace(0, SAMPLE_RATE // 2, N_FFT // 2 + 1)
    edges = _hertz(torch.linspace(_mel(_LOWEST_HZ), _mel(_HIGHEST_HZ), N_BANDS + 2))
    rise, fall = edges.diff()[:-1, None], edges.diff()[1:, None]
    return torch.minimum((bins - edges[:-2, None]) / rise, (edges[2:, None] - bins) / fall).clamp(min=0)


# Slaney's mel scale (Auditory Toolbox, 1998): 15 mels up to 1 kHz, linear; from there 27 mels for a factor of 6.4.
_KNEE_HZ, _KNEE_MEL, _LINEAR_HZ = 1000.0, 15.0, 200.0 / 3
_LOG_STEP = math.log(6.4) / 27


def _mel(hertz: float) -> float:
    return hertz / _LINEAR_HZ if hertz < _KNEE_HZ else _KNEE_MEL + math.log(hertz / _KNEE_HZ) / _LOG_STEP


def _hertz(mel: torch.Tensor) -> torch.Tensor:
    return torch.where(mel < _KNEE_MEL, mel * _LINEAR_HZ, _KNEE_HZ * torch.exp(_LOG_STEP * (mel - _KNEE_MEL)))

"""Music at another speed, its pitch kept."""

import math
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError
from dancedata.music.kernels import compiling

#: Raised by hand when a stretched signal has other samples.
VERSION = 1
#: Distributions whose version shapes the samples.
PACKAGES = ("librosa", "numpy", "scipy")
#: Seconds of a frame of the phase vocoder: 1024 samples at 44.1 kHz. They shift drum hits by up to 7 ms (speeds 0.8
#: to 1.25), librosa's own 2048 by up to 10.
_FRAME_S = 0.023


def stretched_length(n_samples: int, speed: Fraction) -> int:
    """Return how many samples `stretched` gives, as librosa counts them."""
    return round(n_samples / float(speed))


def stretched(signal: AudioSignal, speed: Fraction) -> AudioSignal:
    """Return a signal `speed` times as fast, with the same pitch (a phase vocoder: librosa.effects.time_stretch).

    What is heard at t seconds is heard at t / speed seconds. DataError "short_audio" if nothing is left.
    """
    if not stretched_length(signal.n_samples, speed):
        raise DataError("the signal is too short to be stretched", reason="short_audio",
                        found=f"{signal.n_samples} samples")  # fmt: skip
    if speed == 1:
        return signal
    _compile_kernels()
    frame = 2 ** max(5, round(math.log2(_FRAME_S * signal.sample_rate)))
    return AudioSignal(_stretched(signal.samples, float(speed), frame), signal.sample_rate)


@lru_cache(maxsize=1)
def _compile_kernels() -> None:
    with compiling():
        _stretched(np.zeros(4096, dtype=np.float32), 1.5, 1024)


def _stretched(samples: NDArray[np.float32], speed: float, frame: int) -> NDArray[np.float32]:
    import librosa

    hop = frame // 4
    # A signal shorter than a frame is padded with zeros, as librosa does with a warning.
    padded = samples if len(samples) >= frame else np.pad(samples, (0, frame - len(samples)))
    spectrum = librosa.stft(padded, n_fft=frame, hop_length=hop)
    faster = librosa.phase_vocoder(spectrum, rate=speed, hop_length=hop, n_fft=frame)
    length = round(len(samples) / speed)
    return np.asarray(librosa.istft(faster, n_fft=frame, hop_length=hop, dtype=np.float32, length=length))

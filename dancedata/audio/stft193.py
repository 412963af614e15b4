"""The 193 columns of a short-time Fourier transform that GCDance reads beside Wav2CLIP (Liu et al. 2025)."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._settings import HOP
from dancedata.core.audio_signal import AudioSignal, resampled_length
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import AudioFeature
from dancedata.core.registry import FEATURES
from dancedata.core.typing import override
from dancedata.kernel import resample

N_FFT = 384
_BINS = 1 + N_FFT // 2


@FEATURES.register("stft193")
@dataclass(frozen=True)
class Stft193(AudioFeature):
    """Short-time Fourier transform of 384 samples at a hop of 512, at a sample rate of 512 times the rows per second.

    A quarter of the samples, between two windows, is in no row.

    Parameters
    ----------
    part
        "real", the default: what GCDance trains on, as its loader casts the complex numbers that its script writes to
        float32. "magnitude": their absolute value.
    """

    part: Literal["real", "magnitude"] = "real"

    version: ClassVar[int] = 1
    packages: ClassVar[tuple[str, ...]] = ("librosa", "numpy", "scipy", "soxr")
    uses_tempo: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.part not in ("real", "magnitude"):
            raise UsageError("stft193: invalid value for part", found=str(self.part), allowed="real, magnitude")

    @property
    @override
    def columns(self) -> Columns:
        return Columns((Group("stft", _BINS, "full scale"),), None)

    @override
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        return 1 + resampled_length(n_samples, sample_rate, _feature_rate(grid)) // HOP

    @override
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> NDArray[np.float32]:
        """Transform a whole song; column k is at k / 384 of the sample rate: 40 Hz apart at 30 rows per second.

        UsageError for a rate of which 512 times is not a whole number.
        """
        import librosa

        from dancedata.audio._librosa import known_warnings

        self.require_samples(signal)
        samples = resample(signal.samples, signal.sample_rate, _feature_rate(grid))
        with known_warnings():
            spectrum = librosa.stft(samples, n_fft=N_FFT, hop_length=HOP)
        rows = spectrum.real if self.part == "real" else np.abs(spectrum)
        return np.ascontiguousarray(rows.T, dtype=np.float32)


def _feature_rate(grid: FrameGrid) -> int:
    rate = grid.divided(HOP).rate
    if rate.denominator != 1:
        raise UsageError("stft193 cannot be computed at this frame rate",
                         found=f"{grid.rate} rows per second, so a sample rate of {float(rate):g} Hz",
                         allowed="a rate that makes 512 x rate a whole number",
                         fix="use 30 rows per second (GCDance)")  # fmt: skip
    return int(rate)

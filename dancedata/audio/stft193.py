"""The 193 columns of a short-time Fourier transform that GCDance reads beside Wav2CLIP (Liu et al. 2025)."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._settings import HOP, HopFeature
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import FEATURES
from dancedata.core.typing import override
from dancedata.kernel import resample

N_FFT = 384


@FEATURES.register("stft193")
@dataclass(frozen=True)
class Stft193(HopFeature):
    """Short-time Fourier transform of 384 samples at a hop of 512, at a sample rate of 512 times the rows per second.

    A quarter of the samples, between two windows, is in no row.

    Parameters
    ----------
    part
        "real", the default: what GCDance trains on, as its loader casts the complex numbers that its script writes to
        float32. "magnitude": their absolute value.
    """

    part: Literal["real", "magnitude"] = "real"

    columns: ClassVar[Columns] = Columns((Group("stft", 1 + N_FFT // 2, "full scale"),), None)
    usual_rates: ClassVar[str] = "use 30 rows per second (GCDance)"
    uses_tempo: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.part not in ("real", "magnitude"):
            raise UsageError("stft193: invalid value for part", found=str(self.part), allowed="real, magnitude")

    @override
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> NDArray[np.float32]:
        """Transform a whole song; column k is at k / 384 of the sample rate: 40 Hz apart at 30 rows per second.

        UsageError for a rate of which 512 times is not a whole number.
        """
        import librosa

        from dancedata.audio._librosa import known_warnings

        self.require_samples(signal)
        samples = resample(signal.samples, signal.sample_rate, self.feature_rate(grid))
        with known_warnings():
            spectrum = librosa.stft(samples, n_fft=N_FFT, hop_length=HOP)
        rows = spectrum.real if self.part == "real" else np.abs(spectrum)
        return np.ascontiguousarray(rows.T, dtype=np.float32)

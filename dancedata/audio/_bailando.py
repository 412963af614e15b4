"""Columns of music that Bailando and those after it read.

MFCC, their derivative, chroma of the harmonic part, onset envelope, beats and tempogram of the percussive part, at a
hop of 512 samples and a sample rate of 512 times the frame rate: 60 rows per second with motion, 7.5 for the GPT of
Bailando (Siyao et al., CVPR 2022, and its public preparation script). The numbers are librosa's own.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._settings import HOP, HopFeature
from dancedata.core.audio_signal import AudioSignal, pcm16
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.typing import override
from dancedata.kernel import compiling, resample

#: That of 7.5 rows per second, the lowest of Bailando's two; the five octaves of chroma need about 1 kHz.
MIN_SAMPLE_RATE = 3840
#: Upper limit of the onset envelope's mel bands in librosa 0.8, for any sample rate.
_ERA_FMAX = 11025.0
N_MFCC, N_CHROMA, N_LAGS = 20, 12, 384
#: Frames that the derivative of MFCC spans: fewer have none.
_DELTA_WIDTH = 3
#: The sample rate at which chroma have seven octaves; five at every other one.
_RATE_OF_SEVEN_OCTAVES = 60 * HOP

Floats = NDArray[np.float32]

GROUPS = (
    Group("mfcc", N_MFCC, "dB"),
    Group("mfcc_delta", N_MFCC, "dB"),
    Group("chroma_cqt", N_CHROMA, "1"),
    Group("onset_envelope", 1, "dB"),
    Group("beat", 1, "0/1"),
    Group("tempogram", N_LAGS, "1"),
)


@dataclass(frozen=True)
class BailandoFeature(HopFeature):
    """Base of features with Bailando's columns; `onset_fmax` is as of `bailando438`."""

    onset_fmax: Literal["era", "nyquist"] = "era"

    beat_rows_late: ClassVar[int] = 1
    columns: ClassVar[Columns] = Columns(GROUPS, None)
    min_sample_rate: ClassVar[int] = MIN_SAMPLE_RATE
    usual_rates: ClassVar[str] = "use 60 (next to motion) or 7.5 (Bailando's GPT) rows per second"
    #: Bailando's script starts the search for the tempo at 120 beats per minute, for any song.
    uses_tempo: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.onset_fmax not in ("era", "nyquist"):
            raise UsageError(
                f"{self.name}: invalid value for onset_fmax", found=str(self.onset_fmax), allowed="era, nyquist"
            )

    @override
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> NDArray[np.float32]:
        """Features of a whole song, as Bailando computes them; see `AudioFeature.extract`.

        Bailando has 60 or 7.5 rows per second. Any rate of at least 7.5 for which 512 times it is a whole number is
        taken; chroma have seven octaves at 60, five at the others. "short_audio": fewer than 3 rows.
        """
        self.require_samples(signal)
        rate = self.feature_rate(grid)
        available = self.n_rows(signal.n_samples, signal.sample_rate, grid)
        if available < _DELTA_WIDTH:
            raise DataError(f"{self.name}: the audio is too short for the derivative of its MFCC",
                            reason="short_audio",
                            found=f"{signal.n_samples} samples at {signal.sample_rate} Hz: rows {available}",
                            allowed=f"audio for at least {_DELTA_WIDTH} rows at {grid.rate} per second")  # fmt: skip
        fmax = _ERA_FMAX if self.onset_fmax == "era" else rate / 2
        compile_kernels()
        return self._rows(resample(signal.samples, signal.sample_rate, rate), rate, fmax)

    def _rows(self, samples: Floats, rate: int, onset_fmax: float) -> Floats:
        return compute(samples, rate, onset_fmax, 7 if rate == _RATE_OF_SEVEN_OCTAVES else 5)

    @override
    def window(self, signal: AudioSignal, start: int, n_samples: int) -> AudioSignal:
        return AudioSignal(pcm16(signal.samples[start : start + n_samples]), signal.sample_rate)


@lru_cache(maxsize=1)
def compile_kernels() -> None:
    """Load the kernels of librosa that are used here: resynthesis needs more than librosa35's."""
    noise = np.random.default_rng(0).standard_normal(_RATE_OF_SEVEN_OCTAVES).astype(np.float32)
    noise[:: _RATE_OF_SEVEN_OCTAVES // 4] = 10.0
    with compiling():
        compute(noise, _RATE_OF_SEVEN_OCTAVES, _RATE_OF_SEVEN_OCTAVES / 2, 7)


def compute(samples: Floats, rate: int, onset_fmax: float, octaves: int) -> Floats:
    """Compute all columns, (T, 438); parameters as of `first_columns`."""
    import librosa

    first = first_columns(samples, rate, onset_fmax, octaves)
    with _known_warnings():
        envelope = first[:, N_MFCC + N_MFCC + N_CHROMA]
        tempogram = librosa.feature.tempogram(onset_envelope=envelope, sr=rate, hop_length=HOP, win_length=N_LAGS)
    return np.ascontiguousarray(np.concatenate([first, tempogram.T], axis=1), dtype=np.float32)


def first_columns(samples: Floats, rate: int, onset_fmax: float, octaves: int) -> Floats:
    """Compute all columns before the tempogram, (T, 54), of samples (n,) at `rate`, T = 1 + n // 512."""
    import librosa

    with _known_warnings():
        mfcc = _mfcc(samples, rate)
        delta = librosa.feature.delta(mfcc, width=_DELTA_WIDTH)
        harmonic, percussive = librosa.effects.hpss(samples)
        chroma = librosa.feature.chroma_cqt(y=harmonic, sr=rate, hop_length=HOP, n_chroma=N_CHROMA, n_octaves=octaves)
        envelope = librosa.onset.onset_strength(
            y=percussive, sr=rate, hop_length=HOP, aggregate=np.median, fmax=onset_fmax
        )
        _, beats = librosa.beat.beat_track(onset_envelope=envelope, sr=rate, hop_length=HOP)
    beat = np.zeros(len(envelope), dtype=np.float32)
    beat[beats] = 1
    rows = np.concatenate([mfcc, delta, chroma, envelope[np.newaxis], beat[np.newaxis]]).T
    return np.ascontiguousarray(rows, dtype=np.float32)


def _mfcc(samples: Floats, rate: int) -> Floats:
    """Return (20, T); 0 dB is the largest value of the mel spectrum of the whole signal."""
    import librosa

    mel = librosa.feature.melspectrogram(y=samples, sr=rate, hop_length=HOP)
    mfcc: Floats = librosa.feature.mfcc(S=librosa.power_to_db(mel, ref=np.max), n_mfcc=N_MFCC)
    return mfcc


@contextmanager
def _known_warnings() -> Iterator[None]:
    """Hide the known warnings, and that about mel bands above half the sample rate: their being empty is meant."""
    from dancedata.audio._librosa import known_warnings

    with known_warnings():
        warnings.filterwarnings("ignore", message="Empty filters detected in mel", category=UserWarning)
        yield

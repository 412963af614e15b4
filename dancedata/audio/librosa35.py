"""The 35 librosa columns of EDGE, Lodge, FineDance and FACT.

Onset envelope, 20 MFCC, 12 chroma CENS, onset peaks and beats: librosa's defaults at a hop of 512 samples
and a sample rate of 512 times the frame rate. Sources: FACT (Li et al. 2021, the mint repository), whose
function EDGE (Tseng et al. 2023) and Lodge (Li et al. 2024) took over. The numbers are librosa's own; 0.11
and 1.0 gave the same bits at 24 frames a second and above, at 20 chroma differing by up to 0.03.

This is the plain version, one librosa call a column group. It is the oracle for faster ones.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from filelock import FileLock
from numpy.typing import NDArray

from dancedata.audio.signal import pcm16, resample, resampled_length
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import FEATURES

HOP = 512
# The tempo fallback hears the audio as `librosa.load` gives it by default.
TEMPO_SAMPLE_RATE = 22050
# The top chroma filter reaches 4,107 Hz, 4,147 with the tuning half a bin up: the Nyquist frequency must
# lie above.
MIN_SAMPLE_RATE = 8300
# Beyond it the squared spectrum might overflow float32; full scale is 1.
MAX_SAMPLE = 1e12

_GROUPS = (
    Group("onset_envelope", 1, "dB"),
    Group("mfcc", 20, "dB"),
    Group("chroma_cens", 12, "1"),
    Group("onset_peak", 1, "0/1"),
    Group("beat", 1, "0/1"),
)
N_COLUMNS = 35


@FEATURES.register("librosa35")
@dataclass(frozen=True)
class Librosa35:
    """Onset envelope 1, MFCC 20, chroma CENS 12, onset peaks 1, beats 1.

    Parameters
    ----------
    tightness
        How closely beats keep to the tempo (librosa's `beat_track`); 100 in all reference implementations.
    """

    tightness: float = 100

    version: ClassVar[int] = 1
    packages: ClassVar[tuple[str, ...]] = ("librosa", "numpy", "scipy", "soxr")
    dtype: ClassVar[str] = "float32"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.tightness) and self.tightness > 0):
            raise UsageError("librosa35: bad tightness", found=str(self.tightness), allowed="a number above 0")

    @property
    def columns(self) -> Columns:
        """Names, widths and units of the 35 columns; music has no mirror image."""
        return Columns(_GROUPS, None)

    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Rows that `extract` gives for so many samples: 1 + floor(resampled length / 512)."""
        return 1 + resampled_length(n_samples, sample_rate, _feature_rate(grid)) // HOP

    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> NDArray[np.float32]:
        """Features of a whole track, as Lodge, FineDance and FACT compute them.

        Parameters
        ----------
        signal
            Mono samples (n,) float32 at any rate. Signals shorter than an STFT frame (2,048 samples at the
            feature's rate) are padded with zeros, as librosa does at the ends of every signal.
        grid
            Frame rate; 512 times it must be a whole number of at least 8,300 samples a second.
        start_bpm
            Where the beat tracker's search for the tempo starts, beats a minute. None: librosa's estimate
            from the signal at 22,050 Hz.

        Returns
        -------
        NDArray[np.float32]
            (T, 35), T = `n_rows(n, rate, grid)`; row t is centred on t / fps seconds.

        Raises
        ------
        UsageError
            Frame rate or `start_bpm` out of range.
        DataError
            Reason ``empty_audio`` (no sample) or ``nan`` (samples that are not finite, or beyond 1e12).
        """
        rate = _feature_rate(grid)
        _require_bpm(start_bpm)
        _require_samples(signal)
        return self._features(signal.samples, signal.sample_rate, rate, start_bpm)

    def extract_windows(
        self,
        signal: AudioSignal,
        starts: NDArray[np.int64],
        n_samples: int,
        grid: FrameGrid,
        n_rows: int,
        *,
        start_bpm: float | None = None,
    ) -> NDArray[np.float32]:
        """Features of windows, each one by itself from its own 16-bit wav, as EDGE computes them.

        Resampling, padding, the 80 dB floor, tuning, CENS smoothing, tempo, beats: all see the window alone.

        Parameters
        ----------
        signal
            The whole song, mono samples (n,) float32.
        starts
            (W,) first sample of each window.
        n_samples
            Samples a window, at the signal's rate.
        grid
            Frame rate, as in `extract`.
        n_rows
            Rows to keep of each window (EDGE: 150 of the 151 of 5 s at 30 FPS).
        start_bpm
            As in `extract`; None: the estimate is made for each window by itself.

        Returns
        -------
        NDArray[np.float32]
            (W, n_rows, 35).

        Raises
        ------
        UsageError
            As in `extract`.
        DataError
            As in `extract`; reason ``short_audio`` if a window does not lie within the signal, or is too
            short for `n_rows` rows.
        """
        rate = _feature_rate(grid)
        _require_bpm(start_bpm)
        _require_samples(signal)
        _require_windows(signal, starts, n_samples)
        available = self.n_rows(n_samples, signal.sample_rate, grid)
        if n_rows > available:
            raise DataError(
                "librosa35: the windows are too short for their rows",
                reason="short_audio",
                found=f"{n_samples} samples at {signal.sample_rate} Hz, which give {available} rows",
                allowed=f"audio for {n_rows} rows at {grid.rate} frames a second",
            )
        features = np.empty((len(starts), n_rows, N_COLUMNS), dtype=np.float32)
        for window, start in zip(features, starts, strict=True):
            samples = pcm16(signal.samples[int(start) : int(start) + n_samples])
            window[:] = self._features(samples, signal.sample_rate, rate, start_bpm)[:n_rows]
        return features

    def _features(
        self, samples: NDArray[np.float32], sample_rate: int, rate: int, start_bpm: float | None
    ) -> NDArray[np.float32]:
        """(T, 35) of samples (n,) at `sample_rate`; `rate` is 512 times the frame rate."""
        compile_kernels()
        return _compute(samples, sample_rate, rate, start_bpm, self.tightness)


@lru_cache(maxsize=1)
def compile_kernels() -> None:
    """Load librosa's compiled kernels, one process at a time; once a process.

    numba compiles them on first use in an environment and caches them on disk. Two processes that do so at once
    can end in a segmentation fault (seen with numba 0.68: a kernel's address was 0), so the first run of all
    that `_compute` calls is made under a lock. It is in the user's cache folder, which machines of a cluster
    share as they share the environment.
    """
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(3 * TEMPO_SAMPLE_RATE).astype(np.float32)
    noise[:: TEMPO_SAMPLE_RATE // 2] = 10.0
    with FileLock(_lock_file()):
        _compute(noise, TEMPO_SAMPLE_RATE, 30 * HOP, None, 100.0)


def _lock_file() -> Path:
    name = f"kernels-{hashlib.sha256(sys.prefix.encode()).hexdigest()[:16]}.lock"
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dancedata"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    return (folder if writable else Path(tempfile.gettempdir())) / name


def _compute(
    samples: NDArray[np.float32], sample_rate: int, rate: int, start_bpm: float | None, tightness: float
) -> NDArray[np.float32]:
    """Compute the features of `Librosa35._features`."""
    import librosa

    with _known_librosa_warnings():
        y = resample(samples, sample_rate, rate)
        # Envelope and MFCC see the same dB mel spectrum: computed once, bit-equal to giving y to either.
        mel_db = librosa.power_to_db(librosa.feature.melspectrogram(y=y, sr=rate, hop_length=HOP))
        envelope = librosa.onset.onset_strength(S=mel_db, sr=rate, hop_length=HOP)
        mfcc = librosa.feature.mfcc(S=mel_db, sr=rate, n_mfcc=20)
        chroma = librosa.feature.chroma_cens(y=y, sr=rate, hop_length=HOP, n_chroma=12)
        peaks = librosa.onset.onset_detect(onset_envelope=envelope, sr=rate, hop_length=HOP)
        if start_bpm is None:
            start_bpm = _estimated_bpm(samples, sample_rate)
        _, beats = librosa.beat.beat_track(
            onset_envelope=envelope,
            sr=rate,
            hop_length=HOP,
            start_bpm=start_bpm,
            tightness=tightness,
        )
    features = np.zeros((len(envelope), N_COLUMNS), dtype=np.float32)
    features[:, 0] = envelope
    features[:, 1:21] = mfcc.T
    features[:, 21:33] = chroma.T
    features[peaks, 33] = 1
    features[beats, 34] = 1
    return features


def _feature_rate(grid: FrameGrid) -> int:
    rate = HOP * grid.rate
    if rate.denominator != 1 or rate < MIN_SAMPLE_RATE:
        raise UsageError(
            "librosa35 cannot be computed at this frame rate",
            found=f"{grid.rate} frames a second, so a sample rate of {float(rate):g} Hz",
            allowed=f"a frame rate that makes 512 x rate a whole number of at least {MIN_SAMPLE_RATE} Hz",
            fix="build at 30 (or 60) frames a second; motion of another rate is resampled to it",
        )
    return int(rate)


def _estimated_bpm(samples: NDArray[np.float32], sample_rate: int) -> float:
    import librosa

    y = resample(samples, sample_rate, TEMPO_SAMPLE_RATE)
    return float(librosa.feature.tempo(y=y, sr=TEMPO_SAMPLE_RATE)[0])


def _require_bpm(start_bpm: float | None) -> None:
    if start_bpm is not None and not (math.isfinite(start_bpm) and start_bpm > 0):
        raise UsageError(
            "librosa35: bad start_bpm",
            found=str(start_bpm),
            allowed="beats a minute above 0, or None for an estimate",
        )


def _require_samples(signal: AudioSignal) -> None:
    if len(signal.samples) == 0:
        raise DataError("librosa35: the signal has no samples", reason="empty_audio", found="0 samples")
    # Not "any > maximum": NaN fails every comparison.
    bad = np.flatnonzero(~(np.abs(signal.samples) <= MAX_SAMPLE))
    if bad.size:
        raise DataError(
            "librosa35: the signal has samples that are no numbers, or absurdly large ones",
            reason="nan",
            found=f"{bad.size} samples, the first is {signal.samples[bad[0]]} at sample {bad[0]}",
            allowed=f"finite samples up to {MAX_SAMPLE:g} (full scale is 1)",
            fix="export the file again, as 16-bit wav for example",
        )


def _require_windows(signal: AudioSignal, starts: NDArray[np.int64], n_samples: int) -> None:
    if len(starts) == 0:
        return
    first, last = int(np.min(starts)), int(np.max(starts)) + n_samples
    if first < 0 or last > len(signal.samples):
        raise DataError(
            "librosa35: a window reaches beyond the audio",
            reason="short_audio",
            found=f"windows from sample {first} to {last}",
            allowed=f"0 to {len(signal.samples)} (at {signal.sample_rate} Hz)",
        )


@contextmanager
def _known_librosa_warnings() -> Iterator[None]:
    """Hide the two warnings that short or silent audio gives, whose outcome is the wanted one."""
    with warnings.catch_warnings():
        # Short signals (the lowest chroma octave's frame is about 2 s) are padded with zeros, as any end is.
        warnings.filterwarnings("ignore", message=r"n_fft=\d+ is too large for input signal", category=UserWarning)
        # Silence has no pitch: the tuning is 0, the chroma are 0.
        warnings.filterwarnings("ignore", message="Trying to estimate tuning from empty", category=UserWarning)
        yield

"""librosa35 as librosa computes it, one call a column group: what the fast version is held to.

It is also what computes wherever the fast version cannot: very short signals, and frame rates at which librosa's
filters are not alike in all octaves.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.signal import pcm16, resample
from dancedata.core.locks import file_lock
from dancedata.execution.cache import user_cache

HOP = 512
N_COLUMNS = 35
# The tempo fallback hears the audio as `librosa.load` gives it by default.
TEMPO_SAMPLE_RATE = 22050


def track_features(
    samples: NDArray[np.float32], sample_rate: int, rate: int, start_bpm: float | None, tightness: float
) -> NDArray[np.float32]:
    """Compute the features (T, 35) of a whole signal; `rate` is 512 times the frame rate."""
    compile_kernels()
    return _compute(samples, sample_rate, rate, start_bpm, tightness)


def window_features(
    samples: NDArray[np.float32],
    starts: NDArray[np.int64],
    n_samples: int,
    sample_rate: int,
    rate: int,
    start_bpm: float | None,
    tightness: float,
) -> NDArray[np.float32]:
    """Compute the features (W, T, 35) of windows of a signal, each from its own 16-bit wav; W is not 0."""
    windows = (pcm16(samples[int(start) : int(start) + n_samples]) for start in starts)
    return np.stack([track_features(window, sample_rate, rate, start_bpm, tightness) for window in windows])


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
    with file_lock(_lock_file()):
        _compute(noise, TEMPO_SAMPLE_RATE, 30 * HOP, None, 100.0)


def _lock_file() -> Path:
    name = f"kernels-{hashlib.sha256(sys.prefix.encode()).hexdigest()[:16]}.lock"
    folder = user_cache()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    return (folder if writable else Path(tempfile.gettempdir())) / name


def _compute(
    samples: NDArray[np.float32], sample_rate: int, rate: int, start_bpm: float | None, tightness: float
) -> NDArray[np.float32]:
    """Compute the features of `track_features`."""
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


def estimated_bpm(samples: NDArray[np.float32], sample_rate: int) -> float:
    """Estimate a tempo from a signal alone, beats a minute."""
    compile_kernels()
    with _known_librosa_warnings():
        return _estimated_bpm(samples, sample_rate)


def _estimated_bpm(samples: NDArray[np.float32], sample_rate: int) -> float:
    import librosa

    y = resample(samples, sample_rate, TEMPO_SAMPLE_RATE)
    return float(librosa.feature.tempo(y=y, sr=TEMPO_SAMPLE_RATE)[0])


@contextmanager
def _known_librosa_warnings() -> Iterator[None]:
    """Hide the two warnings that short or silent audio gives, whose outcome is the wanted one."""
    with warnings.catch_warnings():
        # Short signals (the lowest chroma octave's frame is about 2 s) are padded with zeros, as any end is.
        warnings.filterwarnings("ignore", message=r"n_fft=\d+ is too large for input signal", category=UserWarning)
        # Silence has no pitch: the tuning is 0, the chroma are 0.
        warnings.filterwarnings("ignore", message="Trying to estimate tuning from empty", category=UserWarning)
        yield

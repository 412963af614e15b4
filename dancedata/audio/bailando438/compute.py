"""The calls of librosa that make Bailando's columns, in the order of its preparation script."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.kernels import compiling
from dancedata.audio.librosa35.settings import HOP

N_MFCC, N_CHROMA, N_LAGS = 20, 12, 384
N_COLUMNS = 2 * N_MFCC + N_CHROMA + 2 + N_LAGS
#: Frames that the derivative of MFCC spans: fewer have none.
DELTA_WIDTH = 3
#: The sample rate at which chroma have seven octaves; five at every other one.
RATE_OF_SEVEN_OCTAVES = 60 * HOP

Floats = NDArray[np.float32]


def track_features(samples: Floats, rate: int, onset_fmax: float) -> Floats:
    """Compute the columns (T, 438) of samples (n,) at `rate`, T = 1 + n // 512.

    Parameters
    ----------
    onset_fmax
        Upper limit in Hz of the mel bands of the onset envelope.
    """
    compile_kernels()
    return _compute(samples, rate, onset_fmax)


@lru_cache(maxsize=1)
def compile_kernels() -> None:
    """Load the kernels of librosa that are used here, one process at a time and once per process.

    They are more than librosa35's: separating harmonics resynthesises a signal.
    """
    noise = np.random.default_rng(0).standard_normal(RATE_OF_SEVEN_OCTAVES).astype(np.float32)
    noise[:: RATE_OF_SEVEN_OCTAVES // 4] = 10.0
    with compiling():
        _compute(noise, RATE_OF_SEVEN_OCTAVES, RATE_OF_SEVEN_OCTAVES / 2)


def _compute(samples: Floats, rate: int, onset_fmax: float) -> Floats:
    import librosa

    with _known_warnings():
        mfcc = _mfcc(samples, rate)
        delta = librosa.feature.delta(mfcc, width=DELTA_WIDTH)
        harmonic, percussive = librosa.effects.hpss(samples)
        octaves = 7 if rate == RATE_OF_SEVEN_OCTAVES else 5
        chroma = librosa.feature.chroma_cqt(y=harmonic, sr=rate, hop_length=HOP, n_chroma=N_CHROMA, n_octaves=octaves)
        envelope = librosa.onset.onset_strength(
            y=percussive, sr=rate, hop_length=HOP, aggregate=np.median, fmax=onset_fmax
        )
        _, beats = librosa.beat.beat_track(onset_envelope=envelope, sr=rate, hop_length=HOP)
        tempogram = librosa.feature.tempogram(onset_envelope=envelope, sr=rate, hop_length=HOP, win_length=N_LAGS)
    beat = np.zeros(len(envelope), dtype=np.float32)
    beat[beats] = 1
    rows = np.concatenate([mfcc, delta, chroma, envelope[np.newaxis], beat[np.newaxis], tempogram]).T
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
    from dancedata.audio.librosa35.reference import known_warnings

    with known_warnings():
        warnings.filterwarnings("ignore", message="Empty filters detected in mel", category=UserWarning)
        yield

"""The reference version of librosa35: one librosa call per column group.

The fast version is tested against it. It also computes everything that the fast version cannot: very short signals,
and frame rates at which librosa's filters differ between octaves.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._settings import HOP, N_COLUMNS, TEMPO_SAMPLE_RATE, Settings
from dancedata.core.audio_signal import pcm16
from dancedata.kernel import compiling, resample


def track_features(samples: NDArray[np.float32], settings: Settings) -> NDArray[np.float32]:
    """Compute the features (T, 35) of a whole signal (n,)."""
    compile_kernels()
    return _compute(samples, settings)


def window_features(
    samples: NDArray[np.float32], starts: NDArray[np.int64], n_samples: int, settings: Settings
) -> NDArray[np.float32]:
    """Compute the features (W, T, 35) of windows of a signal, each from its own 16-bit wav; W is not 0."""
    windows = (pcm16(samples[int(start) : int(start) + n_samples]) for start in starts)
    return np.stack([track_features(window, settings) for window in windows])


@lru_cache(maxsize=1)
def compile_kernels() -> None:
    """Load librosa's compiled kernels, one process at a time and once per process."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(3 * TEMPO_SAMPLE_RATE).astype(np.float32)
    noise[:: TEMPO_SAMPLE_RATE // 2] = 10.0
    with compiling():
        _compute(noise, Settings(TEMPO_SAMPLE_RATE, 30 * HOP, None, 100.0))


def _compute(samples: NDArray[np.float32], settings: Settings) -> NDArray[np.float32]:
    import librosa

    rate, start_bpm = settings.rate, settings.start_bpm
    with known_warnings():
        y = resample(samples, settings.sample_rate, rate)
        # Envelope and MFCC use the same dB mel spectrum: computed once, bit-equal to passing y to both.
        mel_db = librosa.power_to_db(librosa.feature.melspectrogram(y=y, sr=rate, hop_length=HOP))
        envelope = librosa.onset.onset_strength(S=mel_db, sr=rate, hop_length=HOP)
        mfcc = librosa.feature.mfcc(S=mel_db, sr=rate, n_mfcc=20)
        chroma = librosa.feature.chroma_cens(y=y, sr=rate, hop_length=HOP, n_chroma=12)
        peaks = librosa.onset.onset_detect(onset_envelope=envelope, sr=rate, hop_length=HOP)
        if start_bpm is None:
            start_bpm = _estimated_bpm(samples, settings.sample_rate)
        _, beats = librosa.beat.beat_track(
            onset_envelope=envelope,
            sr=rate,
            hop_length=HOP,
            start_bpm=start_bpm,
            tightness=settings.tightness,
        )
    features = np.zeros((len(envelope), N_COLUMNS), dtype=np.float32)
    features[:, 0] = envelope
    features[:, 1:21] = mfcc.T
    features[:, 21:33] = chroma.T
    features[peaks, 33] = 1
    features[beats, 34] = 1
    return features


def estimated_bpm(samples: NDArray[np.float32], sample_rate: int) -> float:
    """Estimate a tempo from a signal alone, in beats per minute."""
    compile_kernels()
    with known_warnings():
        return _estimated_bpm(samples, sample_rate)


def _estimated_bpm(samples: NDArray[np.float32], sample_rate: int) -> float:
    import librosa

    y = resample(samples, sample_rate, TEMPO_SAMPLE_RATE)
    return float(librosa.feature.tempo(y=y, sr=TEMPO_SAMPLE_RATE)[0])


@contextmanager
def known_warnings() -> Iterator[None]:
    """Hide the warnings that librosa gives for short or silent audio; its results are right."""
    with warnings.catch_warnings():
        # Short signals (the lowest chroma octave's frame is about 2 s) are padded with zeros, as all ends are.
        warnings.filterwarnings("ignore", message=r"n_fft=\d+ is too large for input signal", category=UserWarning)
        # Silence has no pitch: the tuning is 0, the chroma are 0.
        warnings.filterwarnings("ignore", message="Trying to estimate tuning from empty", category=UserWarning)
        yield

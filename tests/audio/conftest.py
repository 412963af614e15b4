"""Sounds that the audio tests write or hear."""

import pickle
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import librosa
import numpy as np
import pytest
from numpy.typing import NDArray

from dancedata.audio._librosa import compile_kernels
from dancedata.core.audio_signal import AudioSignal

RATE = 48000
BEAT_S = 0.5
NAME_OF_FILTERS = "__vqt_filter_fft"
CHORD_HZ = (261.6256, 329.6276, 391.9954)  # C4, E4, G4


def _click_track(seconds: float) -> NDArray[np.float32]:
    """Noise bursts of 20 ms at 0.25, 0.75, ... s (120 BPM) over a C major chord."""
    rng = np.random.default_rng(7)
    time_s = np.arange(round(seconds * RATE)) / RATE
    samples = sum(0.05 * np.sin(2 * np.pi * hz * time_s) for hz in CHORD_HZ)
    burst = rng.standard_normal(960) * np.exp(-np.arange(960) / 200.0) * 0.3
    for beat_s in np.arange(BEAT_S / 2, seconds - 0.05, BEAT_S):
        start = round(beat_s * RATE)
        samples[start : start + 960] += burst
    return np.asarray(samples, dtype=np.float32)


@pytest.fixture(scope="session")
def clicks() -> AudioSignal:
    """8 s at 48 kHz, 120 BPM, C major."""
    return AudioSignal(_click_track(8.0), RATE)


@pytest.fixture(scope="session")
def stereo_noise() -> NDArray[np.float32]:
    """(30011, 2) float32 within +-0.9."""
    return np.random.default_rng(3).uniform(-0.9, 0.9, (30011, 2)).astype(np.float32)


@pytest.fixture(scope="session")
def librosa_load() -> Callable[..., NDArray[np.float32]]:
    """`librosa.load`, samples only; librosa 0.11 imports audioread in it, and that deprecated modules."""

    def load(path: Path, sr: int | None = None) -> NDArray[np.float32]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            samples: NDArray[np.float32] = librosa.load(path, sr=sr)[0]
        return samples

    return load


@pytest.fixture(scope="session", autouse=True)
def _kernels() -> None:
    """Compile librosa's kernels under the lock, before tests call librosa itself: pytest's workers run at once."""
    compile_kernels()


@pytest.fixture(scope="package", autouse=True)
def _filters_made_once(_kernels: None) -> Iterator[None]:
    """Keep librosa's filters of the constant-Q transform, which it makes anew in each call: half of its time."""
    from librosa.core import constantq

    plain, kept = getattr(constantq, NAME_OF_FILTERS), {}

    def filters(*args: Any, **kwargs: Any) -> Any:
        key = pickle.dumps((args, kwargs))
        if key not in kept:
            kept[key] = plain(*args, **kwargs)
        basis, n_fft, lengths = kept[key]
        return basis.copy(), n_fft, lengths.copy()  # librosa scales them

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(constantq, NAME_OF_FILTERS, filters)
        yield

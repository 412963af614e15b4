"""Hashes of windows of music: equal where the samples, their number and their rate are, and nowhere else."""

from __future__ import annotations

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.pipeline.audio_units import _window_hashes

RATE, LENGTH = 8000, 9000  # 4.5 blocks
SAMPLES = np.random.default_rng(0).normal(size=40_000).astype(np.float32)


def hashes(samples: np.ndarray, starts: list[int], length: int = LENGTH, rate: int = RATE) -> list[str]:
    return _window_hashes(AudioSignal(samples, rate), starts, length)


def test_they_do_not_depend_on_the_song_the_place_or_the_other_windows() -> None:
    starts = [0, 1000, 2000, 4000, 4001, 12_345, 31_000]
    found = hashes(SAMPLES, starts)
    assert len(set(found)) == len(starts)
    for start, own in zip(starts, found, strict=True):
        assert hashes(SAMPLES, [start]) == [own]
        assert hashes(np.ascontiguousarray(SAMPLES[start : start + LENGTH]), [0]) == [own]


def test_every_sample_counts_and_so_do_length_and_rate() -> None:
    (plain,) = hashes(SAMPLES, [100])
    for place in (100, 2099, 2100, 100 + LENGTH - 1):
        changed = SAMPLES.copy()
        changed[place] += 0.5
        assert hashes(changed, [100]) != [plain]
    for place in (99, 100 + LENGTH):
        changed = SAMPLES.copy()
        changed[place] += 0.5
        assert hashes(changed, [100]) == [plain]
    assert hashes(SAMPLES, [100], length=LENGTH - 1) != [plain]
    assert hashes(SAMPLES, [100], rate=RATE // 2) != [plain]

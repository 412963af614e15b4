"""librosa's kernels are compiled by one process at a time (two at once ended in a segmentation fault)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from filelock import FileLock, Timeout

from dancedata.audio import librosa35
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid


def test_the_first_run_in_a_process_holds_the_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    compute = librosa35._compute
    held = []

    def watched(*args: Any) -> Any:
        # Another lock object, as another process would have.
        try:
            with FileLock(librosa35._lock_file(), timeout=0):
                held.append(False)
        except Timeout:
            held.append(True)
        return compute(*args)

    monkeypatch.setattr(librosa35, "_compute", watched)
    librosa35.compile_kernels.cache_clear()
    noise = np.random.default_rng(1).standard_normal(15360).astype(np.float32)
    for _ in range(2):
        librosa35.Librosa35().extract(AudioSignal(noise, 15360), FrameGrid.of(30), start_bpm=120)
    # All kernels are loaded under the lock, once; after that nothing waits for it.
    assert held == [True, False, False]

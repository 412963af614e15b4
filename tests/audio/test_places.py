"""A window's numbers do not depend on the windows requested with it, on any processor.

OpenBLAS has kernels for many processors, chosen when it is loaded: each is tried in a separate process. On a kernel
for AVX2 (AMD's processors, Intel's without AVX-512) a row of a product depends on its place among the rows, so that
any sum whose place is not the window's own shows here.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import librosa
import numpy as np
import pytest
from numpy.typing import NDArray

from dancedata.audio import _bailando as b438
from dancedata.audio import _librosa as plain
from dancedata.audio.bailando438 import Bailando438
from dancedata.audio.librosa35.arrays import BLOCK, aligned, each_times, times_on_grid
from dancedata.audio.librosa35.beats import window_beats, window_tempos
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.audio.librosa35.spectra import onset_peaks
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid
from dancedata.files.locks import file_lock
from dancedata.music import kernels

RNG = np.random.default_rng(8)
SCRIPT = """
import sys
import numpy as np
import threadpoolctl
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid
from dancedata.synthetic import synthesise_song

kernels = {pool.get("architecture") for pool in threadpoolctl.threadpool_info()}
feature, grid = Librosa35(), FrameGrid.of(30)
for rate in (48000, 44100, 15360):
    song = synthesise_song("mPO1", length_s=10.0, sample_rate=rate, n_channels=1).signal.samples
    signal = AudioSignal(np.tile(song, 8), rate)  # long enough for two tiles
    starts = np.arange(0, signal.n_samples - 5 * rate, rate)
    every = feature.extract_windows(signal, starts, 5 * rate, grid, 150, start_bpm=100.0)
    rng = np.random.default_rng(6)
    for size in (1, 2, 17, len(starts) - 3):
        some = np.sort(rng.permutation(len(starts))[:size])
        alone = feature.extract_windows(signal, starts[some], 5 * rate, grid, 150, start_bpm=100.0)
        differ = np.flatnonzero((alone != every[some]).any(axis=(1, 2)))
        assert not len(differ), f"{rate} Hz, {size} windows: {len(differ)} differ"
print(*sorted(kernels))
"""
# A kernel, the flag of /proc/cpuinfo without which it would end in an illegal instruction, and its name by itself:
# OpenBLAS as wheels of numpy have it takes one kernel for Haswell and Zen.
KERNELS = {
    "Haswell": ("avx2", "Haswell"),
    "Zen": ("avx2", "Haswell"),
    "Sandybridge": ("avx", "Sandybridge"),
    "Nehalem": ("sse4_2", "Nehalem"),
    "SkylakeX": ("avx512f", "SkylakeX"),
}


@pytest.mark.parametrize(
    "kernel", [pytest.param(k, marks=() if k == "Haswell" else pytest.mark.nightly) for k in KERNELS]
)
def test_a_window_does_not_depend_on_the_others(kernel: str) -> None:
    flag, name = KERNELS[kernel]
    cpuinfo = Path("/proc/cpuinfo")
    if not cpuinfo.is_file() or f" {flag} " not in cpuinfo.read_text(encoding="utf-8"):
        pytest.skip(f"this processor has no {flag}")
    environment = {**os.environ, "OPENBLAS_CORETYPE": kernel}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    if done.stdout.split() != [name]:
        pytest.skip(f"this BLAS has no kernel {kernel}: {done.stdout.strip()}")


@pytest.mark.parametrize("count", [1, 5, BLOCK, 3 * BLOCK + 7])
def test_products_on_a_grid(count: int) -> None:
    rows, matrix = (RNG.standard_normal(shape).astype(np.float32) for shape in ((5 * BLOCK, 70), (70, 9)))
    every = times_on_grid(rows, matrix, 0)
    np.testing.assert_allclose(every, rows.astype(np.float64) @ matrix, rtol=0, atol=1e-4)
    for first in (0, 1, BLOCK - 1, BLOCK, BLOCK + 3):
        part = slice(first, first + count)
        assert np.array_equal(times_on_grid(rows[part], matrix, first), every[part])


def test_single_rows_are_multiplied_alike_wherever_they_lie() -> None:
    rows, matrix = (RNG.standard_normal(shape).astype(np.float32) for shape in ((33, 71), (71, 13)))
    every = each_times(rows, aligned(matrix))
    np.testing.assert_allclose(every, rows.astype(np.float64) @ matrix, rtol=0, atol=1e-4)
    for k in range(len(rows)):
        memory = np.empty(71 + k, dtype=np.float32)[k:]
        memory[:] = rows[k]
        assert np.array_equal(each_times(memory[np.newaxis], aligned(matrix))[0], every[k])
    assert aligned(rows).ctypes.data % 64 == 0
    assert aligned(rows).strides[0] % 64 == 0


# ---- kernels are compiled by one process at a time


@pytest.mark.parametrize(
    ("module", "name", "made"),
    [(plain, "_compute", Librosa35(method="librosa")), (b438, "compute", Bailando438())],
)
def test_the_first_run_in_a_process_holds_the_lock(module, name, made, monkeypatch, tmp_path):
    compute, held = getattr(module, name), []
    # A lock of this test alone: another process of the test run may hold the user's while it compiles.
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def watched(*args: Any) -> Any:
        # Another open file, as another process would have.
        with file_lock(kernels._lock_file(), wait=False) as free:
            held.append(not free)
        return compute(*args)

    monkeypatch.setattr(module, name, watched)
    module.compile_kernels.cache_clear()
    noise = AudioSignal(np.random.default_rng(1).standard_normal(15360).astype(np.float32), 15360)
    for _ in range(2):
        made.extract(noise, FrameGrid.of(30), start_bpm=120)
    # All kernels are loaded under the lock, once; after that nothing waits for it.
    assert held == [True, False, False]


def test_the_fast_version_needs_neither_librosa_nor_numba() -> None:
    """Their import takes seconds in every worker process."""
    script = (
        "import sys, numpy as np\n"
        "from dancedata.audio.librosa35.feature import Librosa35\n"
        "from dancedata.core.audio_signal import AudioSignal\n"
        "from dancedata.core.grid import FrameGrid\n"
        "noise = np.random.default_rng(1).uniform(-0.5, 0.5, 6 * 44100)\n"
        "signal, grid = AudioSignal(noise, 44100), FrameGrid.of(30)\n"
        "feature, starts = Librosa35(), np.array([0, 22050])\n"
        "assert feature.extract_windows(signal, starts, 5 * 44100, grid, 150).shape == (2, 150, 35)\n"
        "assert feature.extract(signal, grid).shape == (181, 35)\n"
        "print(sorted({'librosa', 'numba', 'scipy.signal', 'scipy.ndimage'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


# ---- tempo, beats and peaks of many envelopes are librosa's


RATE = 15360


def _envelopes(n_frames: int, count: int, seed: int) -> NDArray[np.float32]:
    """Onset envelopes of many kinds: noise, pulses, sparse ones, silence."""
    rng, frames = np.random.default_rng(seed), np.arange(n_frames)
    rows = []
    for k in range(count):
        period = rng.uniform(8, 40)
        pulses = np.exp(-0.5 * ((frames + rng.uniform(0, 40)) % period) ** 2) * rng.uniform(0, 20)
        noise = rng.exponential(1.0, n_frames) * rng.choice([0, 0.1, 1, 5])
        rows.append((pulses + noise) * (1 if k % 5 else rng.random(n_frames) < 0.03))
    rows[0] = np.zeros(n_frames)
    rows[1] = 3.0 * (frames == n_frames // 2)
    envelopes = np.array(rows, dtype=np.float32)
    envelopes[:, :3] = 0
    return envelopes


# Seeds 2, 5, 6 and 11 have envelopes whose squares are nothing in float32.
@pytest.mark.parametrize("seed", [0, 6])
@pytest.mark.parametrize(("rate", "n_frames"), [(RATE, 151), (RATE, 700), (30720, 301), (12288, 40)])
def test_tempo_beats_and_peaks(rate: int, n_frames: int, seed: int) -> None:
    envelopes = _envelopes(n_frames, 60, seed)
    tempos = window_tempos(envelopes, rate, 110.0)
    beats = window_beats(envelopes, tempos, rate, 100.0)
    peaks = onset_peaks(envelopes, rate)
    for k, envelope in enumerate(envelopes):
        tempo, frames = librosa.beat.beat_track(onset_envelope=envelope, sr=rate, start_bpm=110.0, tightness=100)
        assert envelope.any() == (float(np.squeeze(tempo)) > 0)
        if envelope.any():
            assert tempos[k] == float(np.squeeze(tempo)), k
        assert np.array_equal(np.flatnonzero(beats[k]), frames), k
        expected = librosa.onset.onset_detect(onset_envelope=envelope, sr=rate)
        assert np.array_equal(np.flatnonzero(peaks[k]), expected), k

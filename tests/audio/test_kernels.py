"""librosa's kernels are compiled by one process at a time (two at once ended in a segmentation fault)."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from dancedata.audio import _bailando as b438
from dancedata.audio import _librosa as plain
from dancedata.audio.bailando438 import Bailando438
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid
from dancedata.files.locks import file_lock
from dancedata.music import kernels


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

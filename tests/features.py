"""Fast stand-ins for audio features, and how columns are compared."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dancedata.audio.bailando438 import Bailando438
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid

#: Gates of librosa35 against what others compute: MFCC reach 500, so 1e-3 is a few float32 steps; beats are equal.
LIBROSA35 = {"onset_envelope": 1e-4, "mfcc": 1e-3, "chroma_cens": 1e-6, "onset_peak": 0.0, "beat": 0.0}


def bailando438_rows(
    self: Bailando438, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None
) -> Any:
    """Rows of bailando438 without librosa, whose kernels take seconds to compile: tests/audio has the feature.

    They depend on the length of the signal, the rate and the parameters; beats are at least 20 rows apart.
    """
    n_rows = self.n_rows(signal.n_samples, signal.sample_rate, grid)
    seed = [signal.n_samples, int(2 * grid.rate), self.onset_fmax == "era"]
    rows = np.random.default_rng(seed).random((n_rows, self.columns.width), dtype=np.float32)
    period = 20 + int(signal.samples.argmax()) % 20
    rows[:, self.columns.slice("beat")] = (np.arange(n_rows) % period == 5)[:, None]
    return rows


def assert_within(gates: Mapping[str, float], columns: Columns, rows: np.ndarray, expected: np.ndarray) -> None:
    """Compare groups of columns, each within its own tolerance."""
    assert rows.shape == expected.shape
    for name, gate in gates.items():
        part = columns.slice(name)
        np.testing.assert_allclose(rows[..., part], expected[..., part], rtol=0, atol=gate, err_msg=name)

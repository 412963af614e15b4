"""Random decisions about samples, as pure functions of (seed, epoch, index): mirroring, and shifts of primitives.

Each has a Philox stream of its own, apart from that of `EpochSampler`, which may have the same seed. Raw bits are
used, not methods of Generator: numpy guarantees bit streams across versions, not algorithms.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_MIRROR_STREAM, _SHIFT_STREAM = 2, 3


def mirrored_windows(seed: int, epoch: int, n_windows: int, probability: float) -> npt.NDArray[np.bool_]:
    """Return which windows are mirrored in an epoch, (n_windows,)."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(_MIRROR_STREAM, epoch)))
    # 53 bits make a float64 in [0, 1): probability 0 mirrors none, 1 all.
    uniform = (stream.random_raw(n_windows) >> np.uint64(11)) * 2.0**-53
    return np.asarray(uniform < probability)


def primitive_shift(seed: int, epoch: int, window: int) -> int:
    """Return by how many frames, -2 to 2, the primitives of a window are shifted in an epoch."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(_SHIFT_STREAM, epoch, window)))
    return int(stream.random_raw() % 5) - 2

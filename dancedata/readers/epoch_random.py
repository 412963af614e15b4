"""Random decisions about samples, as pure functions of (seed, epoch, index): mirrors, crops, shifts of primitives.

Each has a Philox stream of its own, apart from that of `EpochSampler`, which may have the same seed. Raw bits are
used, not methods of Generator: numpy guarantees bit streams across versions, not algorithms.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

# 1 is the stream of orders, 4 that of augmentations.
_MIRROR_STREAM, _SHIFT_STREAM, _CROP_STREAM = 2, 3, 5


def mirrored_windows(seed: int, epoch: int, n_windows: int, probability: float) -> npt.NDArray[np.bool_]:
    """Return which windows are mirrored in an epoch, (n_windows,)."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(_MIRROR_STREAM, epoch)))
    # Probability 0 mirrors none, 1 all.
    return np.asarray(_uniform(stream, n_windows) < probability)


def crop_choices(seed: int, epoch: int, n_choices: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return a number from 0 to n_choices - 1 for each sample of an epoch, (N,), drawn uniformly."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(_CROP_STREAM, epoch)))
    return np.asarray(np.floor(_uniform(stream, len(n_choices)) * n_choices), dtype=np.int64)


def primitive_shift(seed: int, epoch: int, window: int) -> int:
    """Return by how many frames, -2 to 2, the primitives of a window are shifted in an epoch."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(_SHIFT_STREAM, epoch, window)))
    return int(stream.random_raw() % 5) - 2


def _uniform(stream: np.random.Philox, n: int) -> npt.NDArray[np.float64]:
    """Return n numbers in [0, 1), of 53 bits each."""
    return np.asarray((stream.random_raw(n) >> np.uint64(11)) * 2.0**-53)

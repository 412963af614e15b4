"""Random decisions about samples, as pure functions of (seed, epoch, index): mirrors, crops, shifts of primitives.

Each has a Philox stream of its own, apart from that of `EpochSampler`, which may have the same seed. Raw bits are
used, not methods of Generator: numpy guarantees bit streams across versions, not algorithms.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

# 1 is the stream of orders, 4 that of augmentations.
_MIRROR_STREAM, _SHIFT_STREAM, _CROP_STREAM = 2, 3, 5


def mirrored_samples(seed: int, epoch: int, places: Sequence[int], probability: float) -> npt.NDArray[np.bool_]:
    """Return which of the samples at `places` are mirrored in an epoch, (len(places),)."""
    if not probability:
        return np.zeros(len(places), dtype=np.bool_)
    return np.asarray(_uniform(seed, _MIRROR_STREAM, epoch, places) < probability)


def crop_choices(
    seed: int, epoch: int, places: Sequence[int], n_choices: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Return a number from 0 to n_choices - 1 for each of the samples at `places`, drawn uniformly in an epoch."""
    return np.asarray(np.floor(_uniform(seed, _CROP_STREAM, epoch, places) * n_choices), dtype=np.int64)


def primitive_shift(seed: int, epoch: int, window: int) -> int:
    """Return by how many frames, -2 to 2, the primitives of a window are shifted in an epoch."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(_SHIFT_STREAM, epoch, window)))
    return int(stream.random_raw() % 5) - 2


def _uniform(seed: int, key: int, epoch: int, places: Sequence[int]) -> npt.NDArray[np.float64]:
    """Return the numbers of a stream at `places`, in [0, 1), of 53 bits each."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(key, epoch)))
    stop = max(places, default=-1) + 1
    if stop <= 256 * len(places):
        raw = stream.random_raw(stop)[list(places)]
    else:  # a few of very many: a step of Philox's counter gives four numbers
        raw, step = np.empty(len(places), dtype=np.uint64), 0
        for nth in sorted(range(len(places)), key=places.__getitem__):
            target, number = divmod(places[nth], 4)
            # One that was gone through already is gone to again, all the way round.
            stream.advance((target - step) % 2**256)
            raw[nth], step = stream.random_raw(4)[number], target + 1
    return np.asarray((raw >> np.uint64(11)) * 2.0**-53)

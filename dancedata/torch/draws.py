"""Random numbers of samples: any number of a stream, without those before it."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

# 1 is the stream of orders, 4 that of augmentations.
_MIRROR_STREAM, _BIAS_STREAM, _CROP_STREAM = 2, 3, 5


def uniform(seed: int, key: int, epoch: int, places: Sequence[int]) -> npt.NDArray[np.float64]:
    """Return the numbers of a stream at `places`, in [0, 1), of 53 bits each."""
    stop = max(places, default=-1) + 1
    if len(places) < 4 or stop > 256 * len(places):  # a few of very many: cheaper than numpy's stream
        stream, counter = np.random.Philox(key=_stream_key(seed, key, epoch)), 0
        raw = np.empty(len(places), dtype=np.uint64)
        for nth, place in enumerate(map(int, places)):
            stream.advance(place // 4 - counter)  # each value of the counter gives four numbers
            raw[nth], counter = stream.random_raw(4)[place % 4], place // 4 + 1
    else:
        stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(key, epoch)))
        raw = stream.random_raw(stop)[list(places)]
    return np.asarray((raw >> np.uint64(11)) * 2.0**-53)


@lru_cache(maxsize=16)
def _stream_key(seed: int, key: int, epoch: int) -> npt.NDArray[Any]:
    return np.random.SeedSequence(seed, spawn_key=(key, epoch)).generate_state(2, np.uint64)


def mirrored_samples(seed: int, epoch: int, places: Sequence[int], probability: float) -> npt.NDArray[np.bool_]:
    """Return which of the samples at `places` are mirrored in an epoch, (len(places),)."""
    if not probability:
        return np.zeros(len(places), dtype=np.bool_)
    return np.asarray(uniform(seed, _MIRROR_STREAM, epoch, places) < probability)


def crop_choices(
    seed: int, epoch: int, places: Sequence[int], n_choices: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Return a number from 0 to n_choices - 1 for each of the samples at `places`, drawn uniformly in an epoch."""
    return np.asarray(np.floor(uniform(seed, _CROP_STREAM, epoch, places) * n_choices), dtype=np.int64)


def primitive_bias(seed: int, epoch: int, window: int) -> int:
    """Return by how many frames, -2 to 2, the primitives of a window are shifted in an epoch."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(_BIAS_STREAM, epoch, window)))
    return int(stream.random_raw() % 5) - 2

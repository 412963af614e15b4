"""Random numbers of samples: any number of a stream, without those before it."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

_64_BITS = (1 << 64) - 1
# 1 is the stream of orders, 4 that of augmentations.
_MIRROR_STREAM, _BIAS_STREAM, _CROP_STREAM = 2, 3, 5


def uniform(seed: int, key: int, epoch: int, places: Sequence[int]) -> npt.NDArray[np.float64]:
    """Return the numbers of a stream at `places`, in [0, 1), of 53 bits each."""
    stop = max(places, default=-1) + 1
    if len(places) < 4 or stop > 256 * len(places):  # a few of very many: making numpy's stream takes as long as ten
        stream_key = _stream_key(seed, key, epoch)
        raw = np.array([_raw_number(*stream_key, place) for place in places], dtype=np.uint64)
    else:
        stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=(key, epoch)))
        raw = stream.random_raw(stop)[list(places)]
    return np.asarray((raw >> np.uint64(11)) * 2.0**-53)


@lru_cache(maxsize=16)
def _stream_key(seed: int, key: int, epoch: int) -> tuple[int, int]:
    state = np.random.SeedSequence(seed, spawn_key=(key, epoch)).generate_state(2, np.uint64)
    return int(state[0]), int(state[1])


def _raw_number(key_0: int, key_1: int, place: int) -> int:
    """Return number `place` of a stream of Philox 4x64-10 (Salmon et al. 2011), as numpy's `random_raw` does."""
    a, b, c, d = place // 4 + 1, 0, 0, 0  # numpy's counter: each of its values gives four numbers
    for _ in range(10):
        ab, cd = 0xD2E7470EE14C6C93 * a, 0xCA5A826395121157 * c
        a, b, c, d = cd >> 64 ^ b ^ key_0, cd & _64_BITS, ab >> 64 ^ d ^ key_1, ab & _64_BITS
        key_0, key_1 = key_0 + 0x9E3779B97F4A7C15 & _64_BITS, key_1 + 0xBB67AE8584CAA73B & _64_BITS
    return (a, b, c, d)[place % 4]


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

"""Random numbers as a pure function of a key, the same in every process."""

import math
from typing import Self

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array


class Draw:
    """Random numbers of one decision, such as the angle by which one sample is turned: equal keys give equal ones.

    They come from raw bits of numpy's Philox, which numpy guarantees across versions, not those of its Generator.

    Parameters
    ----------
    seed
        Whole number >= 0.
    key
        Whole numbers >= 0 that tell the decision apart from others with the same seed.
    """

    def __init__(self, seed: int, *key: int) -> None:
        self._stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=key))

    @classmethod
    def of_clip(cls, seed: int, clip: str) -> Self:
        """Return the numbers of a clip, by its id: for copies that are stored."""
        return cls(seed, *clip.encode("utf-8", "surrogatepass"))

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """Return a number in [low, high)."""
        return low + (high - low) * float(self._uniform(1)[0])

    def below(self, n: int) -> int:
        """Return a whole number in [0, n); UsageError if n is below 1."""
        if n < 1:
            raise UsageError("there is nothing to draw from", found=n, allowed="1 or more")
        return int(self._stream.random_raw()) % n

    def normal(self, *shape: int) -> Float64Array:
        """Return numbers of the standard normal distribution (Box and Muller 1958).

        They are drawn one after another, so that a larger first axis only adds numbers at the end.
        """
        uniform = self._uniform(2 * math.prod(shape)).reshape(-1, 2)
        radius = np.sqrt(-2.0 * np.log(1.0 - uniform[:, 0]))  # of (0, 1]: no logarithm of 0
        return np.asarray(radius * np.cos(2.0 * np.pi * uniform[:, 1]), dtype=np.float64).reshape(shape)

    def _uniform(self, n: int) -> Float64Array:
        # 53 bits make a float64 in [0, 1).
        bits = np.asarray(self._stream.random_raw(n), dtype=np.uint64)
        return np.asarray((bits >> np.uint64(11)) * 2.0**-53, dtype=np.float64)

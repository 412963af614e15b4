"""The scores of a set of feature vectors against a pool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array
from dancedata.metrics.arguments import known_name
from dancedata.metrics.set_statistics import STATISTICS, constant_columns, diversity, frechet


def checked_statistics(name: str) -> None:
    """Raise UsageError if a name is not a key of `STATISTICS`."""
    known_name("normalisation", name, STATISTICS)


@dataclass(frozen=True)
class SetScores:
    """Frechet distance and diversity of a set, normalised by a pool.

    Attributes
    ----------
    fid
        Frechet distance to the pool.
    div, div_pool
        Diversity of the set and of the pool, both normalised by the pool.
    n_constant
        Columns in which all clips of the pool are equal.
    fid_varying
        Frechet distance without these columns.
    """

    fid: float
    div: float
    div_pool: float
    n_constant: int
    fid_varying: float

    @classmethod
    def of(cls, rows: Float64Array, pool: Float64Array | None, statistics: str = "numpy") -> SetScores:
        """Compare rows (N, D) with a pool (M, D).

        Raises
        ------
        UsageError
            Without a pool.
        Undefined
            "few_clips".
        """
        if pool is None:
            raise UsageError("the scores need a pool of clips to compare with", fix="give the features of a pool")
        normal_pool, normal = STATISTICS[statistics](pool, rows)
        constant = constant_columns(pool)
        fid = frechet(normal, normal_pool)
        varying = fid
        if 0 < len(constant) < normal.shape[1] == np.shape(pool)[1]:
            varying = frechet(np.delete(normal, constant, axis=1), np.delete(normal_pool, constant, axis=1))
        return cls(fid, diversity(normal), diversity(normal_pool), len(constant), varying)

    def named(self, suffix: str) -> dict[str, float]:
        """Return the scores as fid_SUFFIX, div_SUFFIX, div_SUFFIX_pool; with constant columns also what they do."""
        scores = {f"fid_{suffix}": self.fid, f"div_{suffix}": self.div, f"div_{suffix}_pool": self.div_pool}
        if self.n_constant:
            scores |= {
                f"constant_columns_{suffix}": float(self.n_constant),
                f"fid_{suffix}_varying": self.fid_varying,
            }
        return scores

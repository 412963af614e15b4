"""Statistics of sets of feature vectors, and their scores against a pool: Frechet distance, diversity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import require_finite
from dancedata.core.dance import Undefined
from dancedata.core.errors import DataError, UsageError
from dancedata.core.plugins import Metric
from dancedata.core.rotations import Float64Array
from dancedata.core.typing import override
from dancedata.metrics.arguments import IntArray, known_name


@dataclass(frozen=True)
class Normalisation:
    """Normalisation of features: (x - mean of the pool) / (standard deviation of the pool + eps)."""

    source: str
    ddof: int  # the standard deviation divides by M - ddof
    eps: float  # added to the standard deviation
    # whether columns that are constant in the pool are left out, instead of being divided by eps
    leaves_out: bool = False

    def __call__(self, pool: Float64Array, *sets: Float64Array) -> tuple[Float64Array, ...]:
        """Return the pool (M, D) and other sets (N, D), normalised; of (M, D') columns if some are left out.

        Raises Undefined: "few_clips": a pool of ddof clips or fewer, or one without a column that varies.
        """
        pool = checked_rows(pool)
        if self.leaves_out:
            constant = constant_columns(pool)
            if len(constant) == pool.shape[1]:
                raise Undefined("few_clips", found="a pool of equal clips", allowed="clips that differ")
            pool, *others = (np.delete(checked_rows(rows, pool.shape[1]), constant, axis=1) for rows in (pool, *sets))
            sets = tuple(others)
        if len(pool) <= self.ddof:
            raise Undefined("few_clips", found=f"a pool of {len(pool)}", allowed=f"at least {self.ddof + 1}")
        mean, scale = pool.mean(axis=0), pool.std(axis=0, ddof=self.ddof) + self.eps
        return tuple((checked_rows(rows, pool.shape[1]) - mean) / scale for rows in (pool, *sets))


#: By name.
STATISTICS = {
    "numpy": Normalisation("mint, Bailando, Lodge, POPDG, DGSDP, GCD, Motius: numpy's std", 0, 1e-10),
    "torch": Normalisation("MEGADance: torch's std", 1, 1e-10),
    "flowerdance": Normalisation("FlowerDance: torch's std", 1, 1e-4),
    "varying": Normalisation("this project: columns that are constant in the pool do not count", 0, 0.0, True),
}


def checked_rows(rows: npt.ArrayLike, width: int | None = None) -> Float64Array:
    """Return feature vectors (N, D) as float64; DataError ("bad_shape", "nan") if they are not finite rows."""
    array = np.asarray(rows, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] == 0 or width not in (None, array.shape[1]):
        raise DataError("invalid shape of features", reason="bad_shape", found=f"{array.shape}",
                        allowed=f"(N, {'D' if width is None else width})")  # fmt: skip
    require_finite(array, "the array of features", "row")
    return array


def frechet(first: Float64Array, second: Float64Array) -> float:
    """Return the Frechet distance of two sets of vectors, each taken as a Gaussian (Heusel et al. 2017, FID).

    ``|mean difference|^2 + tr C1 + tr C2 - 2 tr sqrt(C1 C2)``, covariances with N - 1. The trace of the root is the
    sum of the singular values of X1 X2^T, where X is the centred set over sqrt(N - 1): real, defined for fewer
    vectors than dimensions, without a matrix root. The originals' scipy.linalg.sqrtm has an error of about 1e-6
    there.

    Parameters
    ----------
    first, second
        (N, D) and (M, D).

    Raises
    ------
    Undefined
        "few_clips": a set of fewer than two.

    Examples
    --------
    >>> import numpy as np
    >>> from dancedata.metrics import frechet
    >>> rows = np.random.default_rng(0).normal(size=(50, 3))
    >>> round(frechet(rows, rows + [3, 0, 0]), 6)
    9.0
    """
    one = checked_rows(first)
    two = checked_rows(second, one.shape[1])
    for rows in (one, two):
        if len(rows) < 2:
            raise Undefined("few_clips", found=f"{len(rows)} clips", allowed="at least 2")
    distance = float(((one.mean(axis=0) - two.mean(axis=0)) ** 2).sum())
    roots = [_root(rows) for rows in (one, two)]
    traces = sum(float((root**2).sum()) for root in roots)
    # Rounding can make the distance of equal sets about -1e-13.
    return max(0.0, distance + traces - 2 * float(np.linalg.svd(roots[0] @ roots[1].T, compute_uv=False).sum()))


def _root(rows: Float64Array) -> Float64Array:
    """Return R, at most (D, D), with R^T R = the covariance of rows (N, D)."""
    centred = (rows - rows.mean(axis=0)) / np.sqrt(len(rows) - 1)
    return centred if len(centred) <= centred.shape[1] else np.asarray(np.linalg.qr(centred, mode="r"))


def diversity(rows: Float64Array) -> float:
    """Return the mean Euclidean distance over all pairs of vectors (N, D).

    Raises
    ------
    Undefined
        "few_clips": fewer than two.

    Examples
    --------
    >>> import numpy as np
    >>> from dancedata.metrics import diversity
    >>> diversity(np.array([[0.0, 0], [3, 4]]))
    5.0
    """
    from scipy.spatial.distance import pdist

    array = checked_rows(rows)
    if len(array) < 2:
        raise Undefined("few_clips", found=f"{len(array)} clips", allowed="at least 2")
    return float(pdist(array).mean())


def constant_columns(pool: Float64Array) -> IntArray:
    """Return the columns in which all vectors of a pool (M, D) are equal.

    Normalising divides them by eps. Where the set has other values there, its Frechet distance is about 1e21.

    Examples
    --------
    >>> import numpy as np
    >>> from dancedata.metrics import constant_columns
    >>> constant_columns(np.array([[1.0, 2], [1, 3]])).tolist()
    [0]
    """
    array = checked_rows(pool)
    return np.flatnonzero(np.ptp(array, axis=0) == 0) if len(array) else np.arange(array.shape[1])


@dataclass(frozen=True)
class SetScores:
    """Frechet distance to a pool and diversity of a set and of the pool, all normalised by the pool."""

    fid: float
    div: float
    div_pool: float
    n_constant: int  # columns in which all clips of the pool are equal; `fid_varying` is without them
    fid_varying: float

    @classmethod
    def of(cls, rows: Float64Array, pool: Float64Array | None, statistics: str = "numpy") -> SetScores:
        """Compare rows (N, D) with a pool (M, D); UsageError without one, Undefined ("few_clips")."""
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
            scores[f"constant_columns_{suffix}"] = float(self.n_constant)
            scores[f"fid_{suffix}_varying"] = self.fid_varying
        return scores


class SetMetric(Metric):
    """Frechet distance and diversity of the rows of clips, normalised by a pool: fid_SCORE and div_SCORE.

    Attributes
    ----------
    score
        Suffix of the names of its scores.
    statistics
        Parameter of the subclasses: normalisation of rows, a key of `STATISTICS`.
    """

    needs_pool: ClassVar[bool] = True
    bounds: ClassVar[tuple[float, float]] = (0, np.inf)
    score: ClassVar[str]
    statistics: str

    def __post_init__(self) -> None:
        known_name("normalisation", self.statistics, STATISTICS)

    @override
    def summarise(self, rows: Float64Array, pool: Float64Array | None = None) -> dict[str, float]:
        return SetScores.of(rows, pool, self.statistics).named(self.score)

"""Statistics of sets of feature vectors: normalising by a pool, Frechet distance, diversity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import Undefined
from dancedata.core.errors import DataError
from dancedata.core.rotations import Float64Array

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Normalisation:
    """How features are normalised: (x - mean of the pool) / (standard deviation of the pool + eps).

    Attributes
    ----------
    source
        Programs that do it so.
    ddof
        The standard deviation divides by M - ddof.
    eps
        Added to the standard deviation.
    leaves_out
        Whether columns that are constant in the pool are left out, instead of being divided by eps.
    """

    source: str
    ddof: int
    eps: float
    leaves_out: bool = False

    def __call__(self, pool: Float64Array, *sets: Float64Array) -> tuple[Float64Array, ...]:
        """Return the pool (M, D) and other sets (N, D), normalised; of (M, D') columns if some are left out.

        Raises
        ------
        Undefined
            "few_clips": a pool of ddof clips or fewer, or one without a column that varies.
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
        raise DataError(
            "invalid shape of features",
            reason="bad_shape",
            found=f"{array.shape}",
            allowed=f"(N, {'D' if width is None else width})",
        )
    bad = ~np.isfinite(array).all(axis=1)
    if bad.any():
        raise DataError(
            "the features hold NaN or infinity",
            reason="nan",
            found=f"{int(bad.sum())} of {len(array)} rows, the first is row {int(np.argmax(bad))}",
        )
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
    """
    from scipy.spatial.distance import pdist

    array = checked_rows(rows)
    if len(array) < 2:
        raise Undefined("few_clips", found=f"{len(array)} clips", allowed="at least 2")
    return float(pdist(array).mean())


def diversity_bound(n_clips: int, n_columns: int) -> float:
    """Return the largest diversity of a pool that is normalised by itself (ddof 0): sqrt(2 D N / (N - 1)).

    A published figure of a ground truth above it is not from this formula.
    """
    if n_clips < 2:
        raise Undefined("few_clips", found=f"{n_clips} clips", allowed="at least 2")
    return float(np.sqrt(2 * n_columns * n_clips / (n_clips - 1)))


def constant_columns(pool: Float64Array) -> IntArray:
    """Return the columns in which all vectors of a pool (M, D) are equal.

    Normalising divides them by eps. Where the set has other values there, its Frechet distance is about 1e21.
    """
    array = checked_rows(pool)
    return np.flatnonzero(np.ptp(array, axis=0) == 0) if len(array) else np.arange(array.shape[1])

"""Array operations whose result for a row does not depend on the rows that come with it.

The features of a window must not depend on which other windows are asked for, to the last bit: datasets are
byte-identical however a build was cut up. Element by element that is so anyway. But BLAS sums in another order
for another number of rows, so matrices are multiplied in blocks of one size.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def times(rows: Floats, matrix: Floats, block: int = 16) -> Floats:
    """Return rows (n, k) @ matrix (k, m), every row as if it were alone: in blocks of rows."""
    count, size = rows.shape
    whole = count // block * block
    product = np.empty((count, matrix.shape[1]), dtype=np.float32)
    blocks = np.ascontiguousarray(rows[:whole]).reshape(-1, block, size)
    np.matmul(blocks, matrix, out=product[:whole].reshape(-1, block, matrix.shape[1]))
    if whole < count:
        last = np.zeros((block, size), dtype=np.float32)
        last[: count - whole] = rows[whole:]
        product[whole:] = np.matmul(last, matrix)[: count - whole]
    return product


def strided(samples: Floats, shape: tuple[int, ...], steps: tuple[int, ...], offset: int = 0) -> Floats:
    """Return a read-only view of contiguous samples; `steps` are in samples. numpy checks that it stays within."""
    size = samples.itemsize
    strides = tuple(step * size for step in steps)
    view: Floats = np.ndarray(shape, samples.dtype, samples, offset * size, strides)
    view.flags.writeable = False
    return view


def cut(track: Floats, starts: NDArray[np.int64], count: int) -> Floats:
    """Copy pieces (W, count) of a track (m,)."""
    return strided(track, (len(track) - count + 1, count), (1, 1))[starts]


def one_blas_thread() -> AbstractContextManager[Any]:
    """Multiply matrices on one thread within the context: the blocks here are too small for two."""
    limit: AbstractContextManager[Any] = _blas().limit(limits=1)
    return limit


@lru_cache(maxsize=1)
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")

"""Array operations whose result for a row does not depend on the other rows.

The features of a window must not depend on the other windows, to the last bit: datasets are byte-identical however
a build was divided. Elementwise operations fulfil this. BLAS, however, rounds a row of a product by its place among
the rows: kernels handle the last rows of a matrix, and on some processors every thirteenth, by other instructions.
So the place of a row must be a property of the row itself:

- rows of a track are multiplied in blocks on the track's own grid (`times_on_grid`);
- rows of a window are multiplied as one matrix per window (`numpy.matmul` of a stack);
- single rows are multiplied one by one (`each_times`).

This assumes nothing about the kernels; tests/audio/test_places.py checks it with every kernel that the processor can
run.
"""

from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

#: Rows per block of `times_on_grid`.
BLOCK = 16
# Bytes; kernels may treat the elements before the first such boundary by themselves.
_ALIGNMENT = 64


def times_on_grid(rows: Floats, matrix: Floats, first: int) -> Floats:
    """Return rows (n, k) @ matrix (k, m); row i is at place ``first + i`` of the grid of blocks."""
    count, size = rows.shape
    product = np.empty((count, matrix.shape[1]), dtype=np.float32)
    begin = min(-first % BLOCK, count)
    end = begin + (count - begin) // BLOCK * BLOCK
    blocks = np.ascontiguousarray(rows[begin:end]).reshape(-1, BLOCK, size)
    np.matmul(blocks, matrix, out=product[begin:end].reshape(-1, BLOCK, matrix.shape[1]))
    for start, stop in ((0, begin), (end, count)):
        if start < stop:
            place = (first + start) % BLOCK
            block = np.zeros((BLOCK, size), dtype=np.float32)
            block[place : place + stop - start] = rows[start:stop]
            product[start:stop] = np.matmul(block, matrix)[place : place + stop - start]
    return product


def each_times(rows: Floats, matrix: Floats) -> Floats:
    """Return rows (n, k) @ matrix (k, m), each row by itself; the matrix must be `aligned`."""
    product = _aligned_empty(len(rows), matrix.shape[1])
    np.matmul(aligned(rows)[:, np.newaxis], matrix, out=product[:, np.newaxis])
    return product


def aligned(rows: Floats) -> Floats:
    """Return a copy of rows (n, k) in which every row begins at a vector boundary."""
    copy = _aligned_empty(*rows.shape)
    copy[:] = rows
    return copy


def _aligned_empty(n_rows: int, size: int) -> Floats:
    step = _ALIGNMENT // np.dtype(np.float32).itemsize
    width = -(-size // step) * step
    memory = np.empty(n_rows * width + step, dtype=np.float32)
    start = -(memory.ctypes.data // memory.itemsize) % step
    return memory[start : start + n_rows * width].reshape(n_rows, width)[:, :size]


def strided(samples: Floats, shape: tuple[int, ...], steps: tuple[int, ...], offset: int = 0) -> Floats:
    """Return a read-only view of contiguous samples; `steps` are in samples. numpy checks the bounds."""
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

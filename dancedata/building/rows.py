"""Rows of a dancer as they are stored: from the cache, changed by the steps that change rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dancedata.building.plugins import Field
from dancedata.building.result import Nothing, Rows
from dancedata.building.take import Take
from dancedata.core.grid import FrameGrid

if TYPE_CHECKING:
    from dancedata.store.stored_clip import LazyArray


@dataclass(frozen=True)
class ChangedRows:
    """Rows (T, D), changed when numpy needs them."""

    array: LazyArray
    field: Field
    take: Take
    dancer: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return tuple(self.array.shape)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        rows = self.take.changed_rows(np.asarray(self.array), self.field.columns, self.field.kind, self.dancer)
        return np.array(rows, dtype=dtype)


@dataclass(frozen=True)
class PlacedRows:
    """Rows from a file, from frame 0 to the last; codes are filled up with the pad."""

    array: LazyArray
    offset: int
    frames: int
    grid: FrameGrid
    field: Field

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        rows = min(self.grid.rows_up(self.frames, of=self.field.grid), self.array.shape[0] - self.offset)
        return max(rows, self.grid.rows_down(self.frames, of=self.field.grid)), self.array.shape[1]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        array, codebook = np.asarray(self.array), self.field.codebook
        out = np.full(self.shape, 0 if codebook is None else codebook.pad, array.dtype)
        rows = array[self.offset : self.offset + len(out)]
        out[: len(rows)] = rows
        return np.asarray(out, dtype=dtype)


def stored_rows(rows: Rows | Nothing, field: Field, take: Take, dancer: int) -> LazyArray:
    """Return the rows of a field that a dancer has of his own, as they are stored."""
    if isinstance(rows, Nothing):
        return np.empty((0, field.columns.width), field.dtype)
    return ChangedRows(rows.array, field, take, dancer) if take.row_steps else rows.array

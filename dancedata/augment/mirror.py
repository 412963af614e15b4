"""The mirror image of a clip: left and right swapped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.columns import Columns, Mirror
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.plugins import CopyAugmentation, Float32Array, SampleAugmentation, SampleField
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.rotations import Float64Array


@AUGMENTATIONS.register("mirror")
@dataclass(frozen=True)
class MirrorImage(CopyAugmentation, SampleAugmentation):
    """Mirror image: sides are swapped and the dance is reflected across the plane x = 0; the music is unchanged.

    It is the signed permutation of columns that readers mirror with, on motion and on key motions. Contacts are
    permuted, not labelled again. It works for every representation whose columns have a mirror image.
    """

    version: ClassVar[int] = 1
    changes: ClassVar[Literal["rows", "motion", "time"]] = "rows"

    def check(self, columns: Columns) -> None:
        """Raise UsageError if the columns have no mirror image."""
        _mirror_of(columns)

    def change_rows(
        self, rows: Float32Array, columns: Columns, *, kind: Literal["motion", "keymotion"], clip: str
    ) -> Float32Array:
        """Return the mirror image of rows (..., D)."""
        return _mirror_of(columns).apply(rows)

    def check_sample(self, field: SampleField) -> None:
        """Raise UsageError if the columns have no mirror image; audio is not mirrored."""
        if field.kind != "audio":
            _mirror_of(field.columns)

    def change_sample(self, rows: Float32Array, field: SampleField, draw: Draw) -> Float32Array:
        """Return the mirror image of rows (L, D)."""
        return _mirror_of(field.columns).apply(rows)

    def scaler_bounds(
        self, low: Float64Array, high: Float64Array, field: SampleField
    ) -> tuple[Float64Array, Float64Array]:
        """Return the joint range of rows and their mirror images."""
        one, other = (_mirror_of(field.columns).apply(bound) for bound in (low, high))
        return np.minimum(low, np.minimum(one, other)), np.maximum(high, np.maximum(one, other))


def _mirror_of(columns: Columns) -> Mirror:
    if columns.mirror is None:
        raise UsageError("its columns have no mirror image")
    return columns.mirror

"""The mirror image of a clip: left and right swapped."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.columns import Columns, Mirror
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.plugins import CopyAugmentation, Float32Array, SampleAugmentation, SampleField
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.core.typing import override


@AUGMENTATIONS.register("mirror")
@dataclass(frozen=True)
class MirrorImage(CopyAugmentation, SampleAugmentation):
    """Mirror image: sides are swapped and the dance is reflected across the plane x = 0; the music is unchanged.

    It is the signed permutation of columns that readers mirror with, on motion and on key motions. Contacts are
    permuted, not labelled again. It works for every representation whose columns have a mirror image.
    """

    acts_on: ClassVar[Literal["world", "body"]] = "world"
    changes: ClassVar[Literal["rows", "motion", "time"]] = "rows"
    mirrors: ClassVar[bool] = True

    @override
    def check(self, columns: Columns) -> None:
        _mirror_of(columns)

    @override
    def change_rows(
        self, rows: Float32Array, columns: Columns, *, kind: Literal["motion", "keymotion"], clip: str
    ) -> Float32Array:
        return _mirror_of(columns).apply(rows)

    @override
    def check_sample(self, field: SampleField) -> None:
        if field.kind != "audio":
            _mirror_of(field.columns)

    @override
    def change_sample(
        self, rows: Float32Array, field: SampleField, draw: Draw, about: Float64Array | None = None
    ) -> Float32Array:
        return _mirror_of(field.columns).apply(rows)

    @override
    def scaler_bounds(
        self, low: Float64Array, high: Float64Array, field: SampleField
    ) -> tuple[Float64Array, Float64Array]:
        bounds = np.stack([low, high, *(_mirror_of(field.columns).apply(bound) for bound in (low, high))])
        return bounds.min(axis=0), bounds.max(axis=0)


def _mirror_of(columns: Columns) -> Mirror:
    if columns.mirror is None:
        raise UsageError("its columns have no mirror image")
    return columns.mirror

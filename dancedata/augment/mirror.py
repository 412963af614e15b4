"""The mirror image of a clip: left and right swapped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from dancedata.core.columns import Columns, Mirror
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Augmentation, Float32Array
from dancedata.core.registry import AUGMENTATIONS


@AUGMENTATIONS.register("mirror")
@dataclass(frozen=True)
class MirrorImage(Augmentation):
    """Mirror image: sides are swapped and the dance is reflected across the plane x = 0; the music is unchanged.

    It is the signed permutation of columns that readers mirror with, on motion and on key motions. Contacts are
    permuted, not labelled again.
    """

    version: ClassVar[int] = 1

    def check(self, columns: Columns) -> None:
        """Raise UsageError if the columns have no mirror image."""
        _mirror_of(columns)

    def change_rows(
        self, rows: Float32Array, columns: Columns, *, kind: Literal["motion", "keymotion"], clip: str
    ) -> Float32Array:
        """Return the mirror image of rows (..., D)."""
        return _mirror_of(columns).apply(rows)


def _mirror_of(columns: Columns) -> Mirror:
    if columns.mirror is None:
        raise UsageError("its columns have no mirror image")
    return columns.mirror

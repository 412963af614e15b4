"""Copies of stored clips under ids of their own; their rows are made when a shard is written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import SourceError
from dancedata.recipes.copies import CopySpec
from dancedata.recipes.fields import KeyMotionField, MotionField
from dancedata.store import StoredClip
from dancedata.store.schema import LazyArray

#: The split whose clips are copied.
_SPLIT = "train"


@dataclass(frozen=True)
class CopiedArray:
    """Rows (..., D) of a copy, made when numpy asks for them."""

    array: LazyArray
    field: MotionField | KeyMotionField
    spec: CopySpec
    clip: str

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return tuple(self.array.shape)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Load the clip's rows and change them."""
        rows = self.spec.rows_of(np.asarray(self.array), self.field.columns, self.field.kind, self.clip)
        return np.array(rows, dtype=dtype)


def is_copied(split: str) -> bool:
    """Tell whether clips of a split are copied: those of train are."""
    return split == _SPLIT


def copies_per_clip(specs: tuple[CopySpec, ...], split: str) -> int:
    """Return how many clips are stored for each clip of a split, itself included."""
    return 1 + len(specs) if is_copied(split) else 1


def copied(
    clip: StoredClip,
    spec: CopySpec,
    fields: Mapping[str, MotionField | KeyMotionField],
    arrays: Mapping[str, LazyArray] | None = None,
) -> StoredClip:
    """Return the copy of a clip under the id `<id>__<name>`; its `source` is the clip.

    Parameters
    ----------
    fields
        All motion and key motion fields.
    arrays
        Encoded rows of the copy's own motion; None: those of the clip.
    """
    motion = {name: CopiedArray(a, fields[name], spec, clip.id) for name, a in (arrays or clip.motion).items()}
    return replace(clip, id=spec.clip_id(clip.id), source=clip.id, motion=motion)


def check_ids(clips: Iterable[tuple[str, str]], specs: tuple[CopySpec, ...]) -> None:
    """Raise SourceError if a copy would get the id of a clip or of another copy.

    Parameters
    ----------
    clips
        Id and split of every clip.
    """
    clips = list(clips)
    taken = {clip for clip, _ in clips}
    for clip in (clip for clip, split in clips if is_copied(split)):
        for spec in specs:
            made = spec.clip_id(clip)
            if made in taken:
                raise SourceError(
                    f"the copy of clip {clip} that augment.{spec.name} makes would get the id of another clip",
                    where=f"clip {made}",
                    fix=f"rename the clip, or build without augment.{spec.name}",
                )
            taken.add(made)

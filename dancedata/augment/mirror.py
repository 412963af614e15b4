"""Mirrored copies of stored clips: every field's columns by its own signed permutation, music unchanged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Mirror
from dancedata.store import StoredClip
from dancedata.store.stored_clip import LazyArray

#: What is added to a clip's id.
SUFFIX = "__mirror"


@dataclass(frozen=True)
class MirroredArray:
    """The mirror image of an array (..., D), made when numpy asks for it."""

    array: LazyArray
    mirror: Mirror

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return tuple(self.array.shape)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Load and mirror the array."""
        return np.array(self.mirror.apply(np.asarray(self.array)), dtype=dtype)


def mirrored_copy(clip: StoredClip, mirrors: Mapping[str, Mirror]) -> StoredClip:
    """Return the mirror image of a clip under the id `<id>__mirror`; its `source` is the clip.

    Parameters
    ----------
    mirrors
        Of every motion and key motion field.
    """
    motion = {name: MirroredArray(array, mirrors[name]) for name, array in clip.motion.items()}
    return replace(clip, id=clip.id + SUFFIX, source=clip.id, motion=motion)

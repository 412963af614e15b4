"""What the writer is given: clips with their arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy.typing as npt

from dancedata.store.clip_columns import ClipRecord


@runtime_checkable
class LazyArray(Protocol):
    """Anything with a shape that numpy can turn into an array: an ndarray, or a file opened on demand."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array, known without loading it."""
        ...

    def __array__(self) -> npt.NDArray[Any]: ...


@dataclass(frozen=True)
class AudioBlock:
    """A piece of audio features.

    Attributes
    ----------
    key
        Identity of the rows: a hash of the signal and of everything that shapes the feature. Blocks of equal key
        are stored once per shard.
    array
        (A, D) rows.
    offset
        Row at frame 0 of the clip (window scope: of the window).
    """

    key: str
    array: LazyArray
    offset: int = 0

    def __repr__(self) -> str:
        return f"AudioBlock({self.key[:12]!r}, {' x '.join(str(n) for n in self.array.shape)}, offset={self.offset})"


@dataclass(frozen=True, kw_only=True)
class StoredClip(ClipRecord):
    """A clip to store: its record and its arrays, which are loaded one at a time, when they are written.

    Attributes
    ----------
    starts
        First frame of every window, at the store's fps, ascending.
    motion
        Per motion and key motion field: (T, D) in track scope, (W, L, D) in window scope.
    audio
        Per audio field: one block in track scope; one per window, (L, D), in window scope.
    """

    starts: tuple[int, ...]
    motion: Mapping[str, LazyArray]
    audio: Mapping[str, tuple[AudioBlock, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        fields = ", ".join([*self.motion, *self.audio])
        return f"StoredClip({self.id!r}, {self.split}, {self.n_frames} frames, {len(self.starts)} windows, {fields})"

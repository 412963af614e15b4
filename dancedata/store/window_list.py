"""WindowList: many windows in a few arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window

IntArray = npt.NDArray[np.int64]
#: Columns of a table may have 32 bits.
Ints = npt.NDArray[np.integer[Any]]


@dataclass(frozen=True, eq=False, repr=False)
class WindowList(Sequence[Window]):
    """Windows as a sequence; each is made on access, so that a million of them take a few arrays.

    Attributes
    ----------
    split
        The windows' split.
    clip_ids
        Ids of the dataset's clips.
    clip
        (W,) number of each window's clip in `clip_ids`.
    start, length
        (W,) frames at the store's fps.
    """

    split: str
    clip_ids: Sequence[str]
    clip: Ints
    start: Ints
    length: Ints

    @classmethod
    def equally_long(cls, split: str, clip_ids: Sequence[str], clip: Ints, start: Ints, length: int) -> WindowList:
        """Return windows of one length, which takes no memory."""
        return cls(split, clip_ids, clip, start, np.broadcast_to(np.int64(length), clip.shape))

    @classmethod
    def joined(cls, split: str, lists: Sequence[WindowList]) -> WindowList:
        """Return the windows of several lists of one dataset, one after another, under the name of a split."""
        if len(lists) == 1:
            return replace(lists[0], split=split)
        clip, start, length = (np.concatenate([getattr(p, n) for p in lists]) for n in ("clip", "start", "length"))
        return cls(split, lists[0].clip_ids, clip, start, length)

    def __len__(self) -> int:
        return len(self.clip)

    @overload
    def __getitem__(self, item: int) -> Window: ...

    @overload
    def __getitem__(self, item: slice) -> WindowList: ...

    def __getitem__(self, item: int | slice) -> Window | WindowList:
        if isinstance(item, slice):
            return self.take(np.arange(len(self))[item])
        return Window(self.clip_ids[int(self.clip[item])], int(self.start[item]), int(self.length[item]))

    def take(self, positions: npt.ArrayLike) -> WindowList:
        """Return the windows at `positions`, or where a mask of booleans is true, in that order."""
        places = np.asarray(positions)
        if places.dtype != np.bool_:
            places = places.astype(np.int64)
        elif places.all() and places.shape == self.clip.shape:
            return self
        clip, start = self.clip[places], self.start[places]
        if self.length.strides == (0,) and len(clip) <= len(self):
            return WindowList(self.split, self.clip_ids, clip, start, self.length[: len(clip)])
        return WindowList(self.split, self.clip_ids, clip, start, self.length[places])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, WindowList):
            return NotImplemented
        return self.split == other.split and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"WindowList({len(self)} windows of {len(self.clip_ids)} clips, split {self.split!r})"

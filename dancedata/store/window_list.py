"""WindowList: many windows in a few arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.store.schema import slice_name


def window_order(
    clip_ids: Sequence[str], clip: npt.NDArray[np.int64], index: npt.NDArray[np.int64], order: str
) -> npt.NDArray[np.int64]:
    """Return the positions (W,) that sort windows into the store's order.

    `clip` and `index` (W,) are each window's clip number and its number in its clip. "time" keeps their order; "name"
    is EDGE's, a plain string sort of ``<clip>_slice<k>``, so slice10 before slice2.
    """
    if order == "time":
        return np.arange(len(clip), dtype=np.int64)
    names = [slice_name(clip_ids[c], k) for c, k in zip(clip.tolist(), index.tolist(), strict=True)]
    return np.asarray(sorted(range(len(names)), key=names.__getitem__), dtype=np.int64)


IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class WindowList(Sequence[Window]):
    """Windows as a sequence; each is made on access, so that a million of them take four arrays.

    Attributes
    ----------
    split
        The windows' split.
    clip_ids
        Ids of the split's clips.
    clip
        (W,) number of each window's clip in `clip_ids`.
    start, length
        (W,) frames at the store's fps.
    number
        (W,) number of each window among the windows of its clip.
    """

    split: str
    clip_ids: tuple[str, ...]
    clip: IntArray
    start: IntArray
    length: IntArray
    number: IntArray

    @classmethod
    def joined(cls, split: str, lists: Sequence[WindowList]) -> WindowList:
        """Return the windows of several lists, one list after another, under the name of a split."""
        before = np.cumsum([0, *(len(part.clip_ids) for part in lists)])[:-1]
        clip = np.concatenate([part.clip + b for part, b in zip(lists, before, strict=True)])
        start, length, number = (
            np.concatenate([getattr(part, name) for part in lists]) for name in ("start", "length", "number")
        )
        ids = tuple(clip_id for part in lists for clip_id in part.clip_ids)
        return cls(split, ids, clip, start, length, number)

    def __len__(self) -> int:
        return len(self.clip)

    @overload
    def __getitem__(self, item: int) -> Window: ...

    @overload
    def __getitem__(self, item: slice) -> WindowList: ...

    def __getitem__(self, item: int | slice) -> Window | WindowList:
        if isinstance(item, slice):
            return self.take(np.arange(len(self))[item])
        return Window(self.clip_ids[self.clip[item]], int(self.start[item]), int(self.length[item]))

    def take(self, positions: npt.ArrayLike) -> WindowList:
        """Return the windows at `positions`, or where a mask of booleans is true, in that order."""
        places = np.asarray(positions)
        if places.dtype != np.bool_:
            places = places.astype(np.int64)
        return WindowList(
            self.split, self.clip_ids, self.clip[places], self.start[places], self.length[places], self.number[places]
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, WindowList):
            return NotImplemented
        return self.split == other.split and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"WindowList({len(self)} windows of {len(self.clip_ids)} clips, split {self.split!r})"

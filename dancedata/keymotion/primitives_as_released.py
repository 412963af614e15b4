"""The primitives of Lodge's released code, with its slips, except that it writes into a copy.

Facts from the authors' repository (li-ronghui/LODGE, the global module's training step), implemented independently.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.metrics.key_motion import HALF, LENGTH, IntArray

#: The code shifts all pieces of a sample except the first and last by one random number of frames in -2 .. 2.
MAX_BIAS = 2
#: Minima closer than this to the window's ends are dropped.
_MARGIN = 12
#: Narrower gaps are not filled while there is a wider one.
_MIN_GAP = 10
#: Root x and z.
_HORIZONTAL = [4, 6]


class Key(NamedTuple):
    """Centre of a soft cue: a minimum, or the middle of a gap."""

    frame: int
    filled: bool


class Pieces(NamedTuple):
    """Frames (K, 8, D), first frames (K,) and sources of the pieces, in the code's order."""

    frames: npt.NDArray[Any]
    start: IntArray
    source: tuple[str, ...]


def key_frames(minima: Sequence[int], count: int, n_window: int) -> list[Key]:
    """Choose `count` key frames of a window.

    Slips of the code, kept: after a minimum is dropped the next one is not checked, so that it stays anywhere; of
    many minima every (M // count)-th is taken, from the first, so that all those near the end of the window may be
    left out; if all gaps are narrow the first one is filled, at any width.

    `minima`: Ascending.
    `count`: 2 (N // n).
    `n_window`: N.
    """
    kept = [Key(int(m), False) for m in minima]
    i = 0
    while i < len(kept):
        if not _MARGIN <= kept[i].frame <= n_window - _MARGIN:
            del kept[i]  # the next one moves to place i, and the loop continues after it
        i += 1
    if len(kept) >= count:
        return kept[:: len(kept) // count][:count]
    while len(kept) < count:
        ends = [LENGTH, *(key.frame for key in kept), n_window - LENGTH]
        gaps = np.diff(ends)
        widest = int(np.argmax(gaps)) if gaps.max() >= _MIN_GAP else 0
        kept.insert(widest, Key((ends[widest] + ends[widest + 1]) // 2, True))
    return kept


def pieces(window: npt.NDArray[Any], keys: Sequence[Key], n: int, bias: int) -> Pieces:
    """Take the pieces that the code joins, each 8 frames, root x and z relative to its own first frame.

    Slips of the code, kept: a piece for an inner border follows every second key, but at n i / K of the local length
    n instead of the window's N; a piece that overlaps an earlier one takes the frames that were already made
    relative, including the first piece if the first key touches it. The height is not changed.

    `window`: (N, D); not modified.
    `keys`: From `key_frames`.
    `bias`: Frames, -2 .. 2.
    Raises UsageError: A piece would be outside of the window.
    """
    written = np.array(window)
    taken = [written[:LENGTH]]
    start, source = [0], ["start"]

    def take(first: int, name: str) -> None:
        if not 0 <= first <= len(written) - LENGTH:
            raise UsageError("variant 'code' would take a piece outside the window",
                             found=f"frames {first} .. {first + LENGTH - 1} of {len(written)} (n {n}, bias {bias})",
                             fix="use longer segments, or variant 'paper'")  # fmt: skip
        piece = written[first : first + LENGTH]
        piece[:, _HORIZONTAL] -= piece[:1, _HORIZONTAL]
        taken.append(piece.copy())
        start.append(first)
        source.append(name)
        # The code's first piece is a view of the window until the first key is joined to it.
        taken[0] = taken[0].copy()

    for i, key in enumerate(keys, start=1):
        centre = min(max(key.frame, LENGTH), len(written) - LENGTH)
        take(centre - HALF + bias, "filled" if key.filled else "minimum")
        if i % 2 == 0 and i < len(keys):
            take(int(n * (i / len(keys))) - HALF + bias, "border")
    take(len(written) - LENGTH, "end")
    return Pieces(np.stack(taken), np.array(start, dtype=np.int64), tuple(source))

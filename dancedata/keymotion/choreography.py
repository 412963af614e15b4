"""Choreographic augmentation: soft cues and their mirror images, placed on the music's beats (Lodge)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Mirror
from dancedata.core.errors import UsageError
from dancedata.keymotion.characteristic_primitives import Primitives
from dancedata.keymotion.minima import HALF, LENGTH, BoolArray, IntArray

#: Most frames that a centre moves to reach a beat.
MAX_SHIFT = 12
#: Centres of Lodge's code as eighths of a segment: 28-36, 60-68, 156-164, 188-196 of 256 frames.
_EIGHTHS = (1, 2, 5, 6)
#: With fewer frames these places overlap.
MIN_SEGMENT = 8 * LENGTH
#: Root translation, in every layout of contacts 4, root 3, rotations.
_ROOT = slice(4, 7)


@dataclass(frozen=True, eq=False)
class PlacedCues:
    """Soft cues and their mirror images, two of each per segment, as targets of local diffusion.

    Attributes
    ----------
    frames
        (2 S, 8, D) for S soft cues: each cue, then its mirror image. A copy, in the dtype of the cues.
    start
        (2 S,) first frame of each in the window, ascending.
    mirrored
        (2 S,) whether it is a mirror image.
    on_beat
        (2 S,) whether its centre, start + 4, was moved to a beat; the others are where Lodge's code puts them.
    free
        (D,) columns that a cue does not fix: the root, columns 4 to 6.
    """

    frames: npt.NDArray[Any]
    start: IntArray
    mirrored: BoolArray
    on_beat: BoolArray
    free: BoolArray

    def __repr__(self) -> str:
        return f"PlacedCues({' x '.join(str(n) for n in self.frames.shape)}, {int(self.on_beat.sum())} on beats)"


def choreographic_augmentation(primitives: Primitives, beats: npt.ArrayLike, mirror: Mirror) -> PlacedCues:
    """Mirror the soft cues, 8 become 16, and place them on beats.

    In each segment of n frames the code's centres are n/8 (first cue), n/4 (its mirror image), 5n/8 (second
    cue) and 3n/4 (its mirror image). In this order each moves to the nearest beat within 12 frames that has no
    other cue; of two equally near ones to the earlier. If there is none, it does not move.

    Cues never overlap: a beat is skipped if the cue's frames [b - 4, b + 4) would overlap those of another cue at its
    current place, or the 4 frames at the segment's ends that belong to hard cues. From n = 256 on, centres are too
    far apart for that.

    Parameters
    ----------
    primitives
        Of either variant, not normalised: a mirror image of normalised columns is another motion.
    beats
        (M,) frames of the music's beats, counted from the start of the window, in any order.
    mirror
        Of the columns.

    Raises
    ------
    UsageError
        Beats, mirror or lengths do not match the primitives.
    """
    n, n_window, width = primitives.n_segment, primitives.n_window, primitives.frames.shape[2]
    if n < MIN_SEGMENT:
        raise UsageError("a segment is too short for four cues", found=f"n {n}", allowed=f"at least {MIN_SEGMENT}")
    if len(mirror.permutation) != width or width < _ROOT.stop:
        raise UsageError(
            "the mirror does not match the columns",
            found=f"{len(mirror.permutation)} columns in the mirror, {width} in the primitives",
            fix="pass ds.fields[name].mirror of the window's field",
        )
    soft = primitives.frames[~primitives.hard]
    frames = np.stack([soft, mirror.apply(soft)], axis=1).reshape(-1, LENGTH, width)
    code = np.array([low + eighth * n // 8 for low in range(0, n_window, n) for eighth in _EIGHTHS], dtype=np.int64)
    centres, on_beat = _on_beats(code, _frames_of_beats(beats, n_window), n)
    free = np.zeros(width, dtype=bool)
    free[_ROOT] = True
    mirrored = np.arange(len(code)) % 2 == 1
    return PlacedCues(frames, centres - HALF, mirrored, on_beat, free)


def _frames_of_beats(beats: npt.ArrayLike, n_window: int) -> IntArray:
    frames = np.asarray(beats)
    if frames.shape == (0,):
        return frames.astype(np.int64)
    if frames.ndim != 1 or not np.issubdtype(frames.dtype, np.integer):
        raise UsageError(
            "invalid beats",
            found=f"{frames.dtype} {frames.shape}",
            allowed="integers (M,)",
            fix="pass np.flatnonzero of the column that is 1 at beats",
        )
    if frames.min() < 0 or frames.max() >= n_window:
        raise UsageError(
            "beats must be frames of the window",
            found=f"{frames.min()} .. {frames.max()}",
            allowed=f"0 .. {n_window - 1}",
            fix="count them from the window's first frame, and omit those of other windows",
        )
    return np.unique(frames).astype(np.int64)


def _on_beats(code: IntArray, beats: IntArray, n: int) -> tuple[IntArray, BoolArray]:
    """Move centres to beats, one after another; centres stay at least 8 frames apart."""
    centres, on_beat = code.copy(), np.zeros(len(code), dtype=bool)
    for i, place in enumerate(code):
        low = place // n * n
        room = (beats >= low + LENGTH) & (beats <= low + n - LENGTH) & (np.abs(beats - place) <= MAX_SHIFT)
        others = np.delete(centres, i)
        near = [b for b in beats[room] if np.abs(others - b).min() >= LENGTH]
        if near:
            centres[i] = min(near, key=lambda b: abs(b - place))
            on_beat[i] = True
    return centres, on_beat

"""Characteristic dance primitives: short pieces that stand for a long window (Lodge; Li et al., CVPR 2024).

A window of N frames consists of N / n local segments. Hard cues are at its ends and at the borders between segments,
which adjacent segments share; each segment has two soft cues inside, at key motions.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SMPLX22, SMPLX55, transfer
from dancedata.core.errors import DataError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array, matrix_from_6d, rotvec_from_matrix
from dancedata.keymotion.primitives_as_released import MAX_BIAS, key_frames, pieces
from dancedata.metrics.key_motion import HALF, LENGTH, BoolArray, IntArray, key_motion

Variant = Literal["paper", "code"]

#: Least number of frames between the centre of a soft cue and the borders of its segment.
MARGIN = 12
#: Least number of frames between the centres of two soft cues, which then do not overlap.
_SPACING = LENGTH
_SOFT_PER_SEGMENT = 2
#: A segment with fewer frames is too short for two soft cues at these distances.
_MIN_SEGMENT = 4 * MARGIN
#: Widths of Lodge's columns: contacts 4, root 3, 22 or 52 joints in 6D.
_LODGE_WIDTHS = (139, 319)


@dataclass(frozen=True, eq=False)
class Primitives:
    """K primitives of 8 frames: hard cues, and two soft cues per segment.

    Attributes
    ----------
    frames
        (K, 8, D) rows of the window, in its dtype; a copy.
    start
        (K,) first frame of each, counted from the start of the window. Ascending in `paper`; in Lodge's order in
        `code`.
    hard
        (K,) whether it is a hard cue.
    filled
        (K,) whether a soft cue is in a gap instead of at a minimum, because there were too few minima.
    source
        (K) of "start", "border", "end" (hard), "minimum" or "filled" (soft).
    n_window, n_segment
        N and n, frames.
    """

    frames: npt.NDArray[Any]
    start: IntArray
    hard: BoolArray
    filled: BoolArray
    source: tuple[str, ...]
    n_window: int
    n_segment: int

    def __repr__(self) -> str:
        shape = " x ".join(str(n) for n in self.frames.shape)
        return f"Primitives({shape}, {int(self.hard.sum())} hard, window {self.n_window}, segment {self.n_segment})"


def primitives(
    window: npt.NDArray[Any],
    N: int = 1024,  # noqa: N803 (Lodge's letters)
    n: int = 256,
    *,
    minima: npt.ArrayLike | None = None,
    prominence: npt.ArrayLike | None = None,
    variant: Variant = "paper",
    bias: int | np.random.Generator = 0,
) -> Primitives:
    """Take the primitives of a window; the window is not modified.

    `paper`: hard cues are the first and last 8 frames, and 8 around each inner border. Soft cues are, in each
    segment, the frames [m - 4, m + 4) around the two most prominent minima m that lie at least 12 frames from
    the segment's borders and 8 from each other (of equal ones the earlier). If there are too few, soft cues are
    placed at the middle of the largest gap between borders and chosen minima (the earlier of equal gaps).

    `code`: as in Lodge's released code (`dancedata.keymotion.primitives_as_released`). The root's x and z are then
    relative to the first frame of each piece, except in the first piece.

    Parameters
    ----------
    window
        (N, D) columns, not normalised. Any columns if `minima` is given, else those of lodge139 or lodge319.
    N, n
        Frames of the window and of a segment; 1024 and 256 give 13 primitives, 8 of them soft.
    minima, prominence
        (M,) frames of the clip's minima within this window, counted from its start, and their depths:
        `KeyMotion.from_rows` of the stored rows. Without them they are found in the window alone, where minima
        near its ends differ from those of the clip. `paper` only: `code` always uses the window alone.
    variant
        "paper" or "code".
    bias
        `code` only: frames, -2 .. 2, by which all pieces except the first and last are shifted; or a generator that
        draws it.

    Raises
    ------
    UsageError
        Lengths, minima or options do not match each other.
    DataError
        "nan" or "bad_rotation", if the minima are found in the columns.
    """
    window = np.asarray(window)
    _check_lengths(window, N, n)
    if variant == "code":
        if minima is not None or prominence is not None:
            raise UsageError("variant 'code' finds the minima of each window itself", found="minima of the clip",
                             fix="omit minima and prominence, or use variant 'paper'")  # fmt: skip
        return _as_released(window, n, bias)
    if variant != "paper":
        raise UsageError(f"unknown variant {variant!r}", fix=did_you_mean(variant, ("paper", "code")))
    if not isinstance(bias, int | np.integer) or bias != 0:
        raise UsageError("variant 'paper' has no bias", found=f"bias {bias!r}", allowed="0")
    if n < _MIN_SEGMENT:
        raise UsageError(
            "a segment is too short for two soft cues", found=f"n {n}", allowed=f"at least {_MIN_SEGMENT}"
        )
    return _as_in_the_paper(window, n, *_minima(window, minima, prominence))


def borders(window: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the first 4 and the last 4 frames of a segment (n, D) as (8, D), for Lodge's local training.

    They are the halves of the hard cues at its ends. A copy, in the dtype of the window.
    """
    window = np.asarray(window)
    if window.ndim != 2 or len(window) < LENGTH:
        raise UsageError(
            "borders: invalid shape of a segment", found=f"{window.shape}", allowed="(n, D), n at least 8"
        )
    return np.concatenate([window[:HALF], window[-HALF:]])


def joints_of(window: npt.NDArray[Any]) -> Float64Array:
    """Return the 55 SMPL-X joints (N, 55, 3), metres, of lodge139 or lodge319 columns, hands and face at rest."""
    window = np.asarray(window)
    if window.ndim != 2 or window.shape[1] not in _LODGE_WIDTHS:
        raise UsageError("minima can only be found in Lodge's columns", found=f"{window.shape[-1]} columns",
                         allowed="lodge139, lodge319",
                         fix="pass minima and prominence, or a window of another field")  # fmt: skip
    body = window[:, 4 : _LODGE_WIDTHS[0]].astype(np.float64)
    if not np.isfinite(body).all():
        raise DataError("the columns have NaN or infinity", reason="nan", where="primitives")
    rows = body[:, 3:].reshape(len(body), SMPLX22.n_joints, 2, 3)
    # Rows of a rotation have length 1. Those of normalised columns do not: their minima would be of another motion.
    bad = (np.abs(np.linalg.norm(rows, axis=-1) - 1) > 0.1).any(axis=-1)
    bad |= np.linalg.norm(np.cross(rows[..., 0, :], rows[..., 1, :]), axis=-1) < 0.1
    if bad.any():
        frame, joint = np.argwhere(bad)[0]
        raise DataError("not a valid 6D rotation", reason="bad_rotation",
                        where=f"primitives, frame {frame}, {SMPLX22.joints[joint]}",
                        found=rows[frame, joint].round(3).tolist(),
                        fix="pass columns that are not normalised")  # fmt: skip
    turns = rotvec_from_matrix(matrix_from_6d(rows.reshape(*rows.shape[:2], 6)))
    # Positions do not depend on the rate.
    return transfer(Motion(body[:, :3], turns, FrameGrid.of(30), SMPLX22), SMPLX55).joints()


def _check_lengths(window: npt.NDArray[Any], n_window: int, n: int) -> None:
    if window.ndim != 2 or len(window) != n_window:
        raise UsageError("N differs from the number of frames of the window",
                         found=f"window {window.shape}, N {n_window}",
                         allowed=f"a window ({n_window}, D)")  # fmt: skip
    if n < 1 or n_window < 1 or n_window % n:
        raise UsageError("N is not a multiple of n", found=f"N {n_window}, n {n}", allowed="N = k n")


def _minima(
    window: npt.NDArray[Any], minima: npt.ArrayLike | None, prominence: npt.ArrayLike | None
) -> tuple[IntArray, Float64Array]:
    """Check the arguments, or find the minima where there are none."""
    if minima is None and prominence is None:
        motion = key_motion(joints_of(window))
        return motion.minima, motion.prominence
    if minima is None or prominence is None:
        raise UsageError("minima and prominence must be given together", found="one of them")
    frames, depth = np.asarray(minima), np.asarray(prominence, dtype=np.float64)
    if frames.shape == depth.shape == (0,):
        return frames.astype(np.int64), depth
    if frames.ndim != 1 or depth.shape != frames.shape or not np.issubdtype(frames.dtype, np.integer):
        raise UsageError("invalid minima or prominence",
                         found=f"minima {frames.dtype} {frames.shape}, prominence {depth.shape}",
                         allowed="integers (M,), numbers (M,)")  # fmt: skip
    if frames.min() < 0 or frames.max() >= len(window) or (np.diff(frames) <= 0).any():
        raise UsageError("minima must be frames of the window, ascending", found=f"{frames.min()} .. {frames.max()}",
                         allowed=f"0 .. {len(window) - 1}",
                         fix="count them from the window's first frame")  # fmt: skip
    if not np.isfinite(depth).all():
        raise UsageError("invalid prominence", found="NaN or infinity", allowed="finite numbers")
    return frames.astype(np.int64), depth


def _as_in_the_paper(window: npt.NDArray[Any], n: int, minima: IntArray, prominence: Float64Array) -> Primitives:
    n_window = len(window)
    cues = [(0, "start")]
    for low in range(0, n_window, n):
        cues += [(m - HALF, source) for m, source in _soft_cues(low, low + n, minima, prominence)]
        cues.append((low + n - HALF, "border") if low + n < n_window else (n_window - LENGTH, "end"))
    start = np.array([first for first, _ in cues], dtype=np.int64)
    source = tuple(name for _, name in cues)
    return _primitives(window[start[:, None] + np.arange(LENGTH)], start, source, n_window, n)


def _soft_cues(low: int, high: int, minima: IntArray, prominence: Float64Array) -> list[tuple[int, str]]:
    """Choose the centres of the soft cues of a segment, frames low .. high - 1; ascending."""
    inside = (minima >= low + MARGIN) & (minima <= high - MARGIN)
    frames, depth = minima[inside], prominence[inside]
    chosen: list[tuple[int, str]] = []
    for m in frames[np.lexsort((frames, -depth))].tolist():
        if len(chosen) < _SOFT_PER_SEGMENT and all(abs(m - centre) >= _SPACING for centre, _ in chosen):
            chosen.append((m, "minimum"))
    while len(chosen) < _SOFT_PER_SEGMENT:
        ends = sorted([low, high, *(m for m, _ in chosen)])
        widest = int(np.argmax(np.diff(ends)))
        chosen.append(((ends[widest] + ends[widest + 1]) // 2, "filled"))
    return sorted(chosen)


def _as_released(window: npt.NDArray[Any], n: int, bias: int | np.random.Generator) -> Primitives:
    shift = int(bias.integers(-MAX_BIAS, MAX_BIAS + 1)) if isinstance(bias, np.random.Generator) else bias
    if not isinstance(shift, int | np.integer) or abs(shift) > MAX_BIAS:
        raise UsageError(
            "invalid value for bias", found=repr(bias), allowed=f"{-MAX_BIAS} .. {MAX_BIAS}, or a generator"
        )
    if len(window) < 2 * LENGTH:
        raise UsageError("the window is too short", found=f"N {len(window)}", allowed=f"at least {2 * LENGTH}")
    minima = key_motion(joints_of(window)).minima.tolist()
    keys = key_frames(minima, _SOFT_PER_SEGMENT * (len(window) // n), len(window))
    return _primitives(*pieces(window, keys, n, int(shift)), len(window), n)


def _primitives(
    frames: npt.NDArray[Any], start: IntArray, source: tuple[str, ...], n_window: int, n: int
) -> Primitives:
    hard = np.array([name in ("start", "border", "end") for name in source])
    filled = np.array([name == "filled" for name in source])
    return Primitives(frames, start, hard, filled, source, n_window, n)

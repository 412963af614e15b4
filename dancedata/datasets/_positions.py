"""Joint positions where rotations belong: found by what they do, and what to do about them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError

__all__ = ["POSITIONS", "require_rotations"]

#: Part of every message about an array that may hold positions.
POSITIONS = (
    "joint positions are not rotations, and dancedata does no inverse kinematics: export BVH from the capture "
    "software, or fit SMPL to the positions with another tool and give its rotations"
)
#: Frames that are looked at.
_LOOKED_AT = 300
_LEAST_FRAMES = 10
#: Vectors from parent to child that move by more than this part of their length, and how many have to.
_MOVES, _LEAST_BONES = 0.05, 6
#: Median over bones of (change of length) / (change of the vector). Rotation vectors of real dances have 0.44 to
#: 0.72; random ones at least 0.18 from ten frames on, 0.33 from sixty on. Positions of a body whose bones keep their
#: length have 0, measured ones more: real dances with 1 cm of noise in each coordinate have 0.11 to 0.24.
_MANY_FRAMES, _RIGID, _RIGID_OF_FEW_FRAMES = 60, 0.25, 0.1
#: Half of all rotation vectors of a body are never longer than half a turn; real dances: 0.44 rad at most.
_LONGEST_MEDIAN = np.pi
#: The translation is a multiple of the first joint, but for a constant, within this part of the movement in its
#: second direction: a pelvis that was measured apart from the translation moves nearly as that does.
_SAME = 0.15
#: A movement along a line has less than this in its second direction, and says nothing.
_LINE = 0.02

Floats = NDArray[np.float64]


def require_rotations(path: Path, what: str, rotations: Floats, translation: Floats, parents: Sequence[int]) -> None:
    """Check that axis-angle rotations are not something else: joint positions, or angles in degrees.

    Parameters
    ----------
    what : name of the array, for messages.
    rotations : (T, J, 3), finite.
    translation : (T, 3) in the file's unit.
    parents : of the J joints; -1 for the first.

    Raises
    ------
    DataError
        ``not_rotations``, with what gives them away.
    """
    step = max(1, len(rotations) // _LOOKED_AT)
    points, root = rotations[::step], translation[::step]
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers near the end of their range
        sign = _root_is_translation(points[:, 0], root) or _bones_keep_their_length(points, parents)
        median = float(np.median(np.linalg.norm(points[:, 1:], axis=-1)))
    if sign:
        raise _not_rotations(path, f"{what} holds joint positions, not rotations", sign, POSITIONS)
    if median > _LONGEST_MEDIAN:
        fix = f"convert degrees to radians. If these are positions: {POSITIONS}"
        found = f"vectors as long as {median:.3g} (median over frames and joints without the first)"
        raise _not_rotations(path, f"{what} holds no rotation vectors in radians", found, fix)


def _root_is_translation(first: Floats, translation: Floats) -> str:
    """Return what is found if the first joint moves as the translation does, whatever their units; else nothing."""
    first, translation = first - first.mean(axis=0), translation - translation.mean(axis=0)
    size = float((first**2).sum())
    if len(first) < _LEAST_FRAMES or not 1e-12 < size < np.inf:
        return ""
    factor = float((first * translation).sum()) / size
    if not 0 < factor < np.inf:
        return ""
    extents = np.linalg.svd(factor * first, compute_uv=False)
    rest = float(np.sqrt(((translation - factor * first) ** 2).sum()))
    same = extents[1] > _LINE * extents[0] and rest <= _SAME * extents[1]
    return "the first joint moves as the translation does" if same else ""


def _bones_keep_their_length(points: Floats, parents: Sequence[int]) -> str:
    """Return what is found if the distances between joints and their parents are constant; else nothing."""
    bones = points[:, 1:] - points[:, list(parents[1:])]
    length = np.linalg.norm(bones, axis=-1)
    moves = np.linalg.norm(bones.std(axis=0), axis=-1)
    judged = moves > _MOVES * length.mean(axis=0)
    if len(points) < _LEAST_FRAMES or judged.sum() < _LEAST_BONES:
        return ""
    share = length.std(axis=0)[judged] / moves[judged]
    rigid = _RIGID if len(points) >= _MANY_FRAMES else _RIGID_OF_FEW_FRAMES
    if not np.median(share) <= rigid:
        return ""
    n, of = int((share <= rigid).sum()), int(judged.sum())
    return f"the distances of {n} of {of} joints to their parents are constant"


def _not_rotations(path: Path, problem: str, found: str, fix: str) -> DataError:
    return DataError(
        problem, reason="not_rotations", where=str(path), found=found, allowed="axis-angle, radians", fix=fix
    )

"""The parts of representations: groups of columns, each with its mirror image."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton

#: Reflection across the plane x = 0, S = diag(-1, 1, 1), as the diagonal.
_S = (-1, 1, 1)
_AXES = "xyz"


@dataclass(frozen=True)
class Part:
    """A group of columns and its mirror: a signed permutation within the group."""

    group: Group
    mirror: Mirror


def columns_of(*parts: Part) -> Columns:
    """Join parts, in order."""
    permutation: list[int] = []
    signs: list[int] = []
    for part in parts:
        permutation += [len(signs) + j for j in part.mirror.permutation]
        signs += part.mirror.signs
    return Columns(tuple(part.group for part in parts), Mirror(tuple(permutation), tuple(signs)))


def contacts(skeleton: Skeleton) -> Part:
    """Return contacts of left ankle, right ankle, left toe, right toe; mirroring swaps the sides."""
    names = tuple(skeleton.joints[j] for j in skeleton.feet)
    return Part(Group("contact", 4, "1", names), Mirror((1, 0, 3, 2), (1, 1, 1, 1)))


def translation() -> Part:
    """Return the root translation, metres."""
    return Part(Group("translation", 3, "m", tuple(_AXES)), Mirror((0, 1, 2), _S))


def positions(skeleton: Skeleton) -> Part:
    """Return joint positions, metres."""
    return per_joint("position", "m", skeleton, tuple(_AXES), _S)


def rotations(skeleton: Skeleton, n_rows: int) -> Part:
    """Return the first rows of each joint's matrix, row by row: 2 rows are 6D, 3 the whole matrix.

    The mirror image of R is S R S, on the joint of the other side (FACT; Lodge): entry (r, c) changes its sign if
    row or column is x, not if both are.
    """
    entries = [(r, c) for r in range(n_rows) for c in range(3)]
    name = {2: "rotation_6d", 3: "rotation_matrix"}[n_rows]
    parts = tuple(f"{r}{_AXES[c]}" for r, c in entries)
    return per_joint(name, "1", skeleton, parts, [_S[r] * _S[c] for r, c in entries])


def per_joint(
    name: str, unit: str, skeleton: Skeleton, entries: Sequence[str], signs: Sequence[int], *, first: int = 0
) -> Part:
    """Return the same entries of every joint from `first` on; mirroring swaps the sides and applies `signs`."""
    other = list(range(skeleton.n_joints))
    for left, right in skeleton.pairs:
        other[left], other[right] = right, left
    width, joints = len(entries), skeleton.joints[first:]
    permutation = tuple(width * (joint - first) + k for joint in other[first:] for k in range(width))
    labels = tuple(f"{joint}.{entry}" for joint in joints for entry in entries)
    return Part(Group(name, len(joints) * width, unit, labels), Mirror(permutation, tuple(signs) * len(joints)))


def packed_positions(motion: Motion) -> npt.NDArray[np.float32]:
    """Return the joint positions of a motion as (T, 3 J), for the columns of `positions`."""
    return motion.joints().reshape(motion.n_frames, -1).astype(np.float32)


def on_floor(directions: Float64Array, least: float) -> Float64Array:
    """Return directions on the floor, (T, 2) as x and z, as unit vectors."""
    length = np.linalg.norm(directions, axis=1)
    directed = np.flatnonzero(length > least)
    if not len(directed):
        return np.tile([0.0, 1.0], (len(directions), 1))
    last = directed[np.maximum(np.searchsorted(directed, np.arange(len(directions)), side="right") - 1, 0)]
    return np.asarray(directions[last] / length[last, None])


def required_rule(rule: ContactRule | None, name: str) -> ContactRule:
    """Return the contact rule; UsageError if it is None."""
    if rule is None:
        raise UsageError(f"{name} needs a contact rule", allowed="a rule such as velocity")
    return rule


def refuse_rule(rule: ContactRule | None, name: str) -> None:
    """Raise UsageError for a contact rule: the representation has no contacts."""
    if rule is not None:
        raise UsageError(f"{name} holds no contacts", found=f"contact rule {rule.name}", fix="omit the rule")


def checked(array: npt.NDArray[Any], width: int, name: str, first: int = 0) -> Float64Array:
    """Return columns `first` and later of (T, `width`) in float64; UsageError for another shape, DataError "nan"."""
    array = np.asarray(array)
    if array.ndim != 2 or array.shape[1] != width:
        raise UsageError(f"{name} decodes (T, {width})", found=f"shape {array.shape}")
    # Before any arithmetic, which would warn about infinity first. Larger numbers are infinity in float32.
    if not (np.abs(array[:, first:]) <= np.finfo(np.float32).max).all():
        raise DataError("the columns have NaN or infinity", reason="nan", where=name)
    return array[:, first:].astype(np.float64)


def refuse_rotations(
    bad: npt.NDArray[np.bool_], rows: Float64Array, problem: str, fix: str, name: str, skeleton: Skeleton
) -> None:
    """Raise DataError "bad_rotation" for the first of the `bad` (T, J) rotations among `rows` (T, J, n), if any."""
    if bad.any():
        frame, joint = np.argwhere(bad)[0]
        raise DataError(problem, reason="bad_rotation", where=f"{name}, frame {frame}, {skeleton.joints[joint]}",
                        found=rows[frame, joint].tolist(), fix=fix)  # fmt: skip

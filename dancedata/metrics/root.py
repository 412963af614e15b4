"""Where the positions of a dance are taken from."""

from __future__ import annotations

from typing import Literal

from dancedata.core.dance import checked_joints
from dancedata.core.rotations import Float64Array
from dancedata.metrics.arguments import known_name

Root = Literal["absolute", "zero_start", "root_relative"]
ROOTS = ("absolute", "zero_start", "root_relative")


def rooted(joints: Float64Array, root: Root) -> Float64Array:
    """Return joint positions (T, J, 3) with another origin.

    Parameters
    ----------
    joints
        (T, J, 3) metres; joint 0 is the root.
    root
        "absolute": as they are. "zero_start": the root's position in frame 0 is subtracted, its height too (Bailando,
        MEGADance, Motius). "root_relative": then the other joints relative to the root of the same frame, while
        joint 0 keeps its path (Lodge).
    """
    known_name("root", root, ROOTS)
    positions = checked_joints(joints)
    if root == "absolute":
        return positions
    moved: Float64Array = positions - positions[0, 0]
    if root == "root_relative":
        moved[:, 1:] -= moved[:, :1]
    return moved

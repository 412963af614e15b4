"""Grounding: putting a motion on the floor y = 0, as Lodge does."""

from __future__ import annotations

from dataclasses import replace

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.rotations import FloatArray
from dancedata.core.skeleton import Skeleton

#: Toes with a smaller difference in height are both on the floor, metres (Lodge, `set_on_ground`).
LEVEL_TOES_M = 0.02


def ground_height(joints: FloatArray, skeleton: Skeleton, frame: int = 0) -> float:
    """Return the height of the floor as estimated by Lodge (Li et al., CVPR 2024; `set_on_ground` of its code).

    The mean of the toes' heights in one frame if they differ by less than 2 cm, else the lower one.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres, +Y up.
    skeleton
        Defines the toes (`feet[2:]`).
    frame
        The frame to use. Lodge first trims a still beginning, so this is the motion's `trim_start`.

    Returns
    -------
    float
        Metres.

    Raises
    ------
    UsageError
        If the frame does not exist.
    """
    if not 0 <= frame < len(joints):
        raise UsageError("the frame for the floor height does not exist", found=f"frame {frame} of {len(joints)}")
    left, right = (float(joints[frame, toe, 1]) for toe in skeleton.feet[2:])
    return (left + right) / 2 if abs(left - right) < LEVEL_TOES_M else min(left, right)


def grounded(motion: Motion, skeleton: Skeleton | None = None) -> Motion:
    """Put a motion on the floor y = 0: all frames are shifted by one height.

    Parameters
    ----------
    motion
        +Y up. The height of the floor is that of `ground_height` in frame `motion.trim_start`.
    skeleton
        Bones for the positions of the toes, with as many joints; default: the motion's own.

    Returns
    -------
    Motion
        On the motion's own skeleton.
    """
    frame = motion.trim_start
    standing = motion.part(frame, frame + 1).on(skeleton or motion.skeleton)
    height = ground_height(standing.joints(), standing.skeleton)
    translation = motion.translation - (0.0, height, 0.0)
    return replace(motion, translation=translation)

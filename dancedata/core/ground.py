"""Where the floor of a motion is, as Lodge finds it."""

from __future__ import annotations

from dataclasses import replace

from dancedata.core.motion import Motion
from dancedata.core.rotations import FloatArray
from dancedata.core.skeleton import Skeleton

#: Toes with a smaller difference in height are both on the floor, metres (Lodge, `set_on_ground`).
_LEVEL_TOES_M = 0.02


def ground_height(joints: FloatArray, skeleton: Skeleton) -> float:
    """Return the height of the floor, metres, as Lodge does (Li et al., CVPR 2024; `set_on_ground` of its code).

    It is the mean of the toes' heights in the first frame if they differ by less than 2 cm, else the lower one.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres, +Y up.
    skeleton
        Defines the toes (`feet[2:]`).
    """
    left, right = (float(joints[0, toe, 1]) for toe in skeleton.feet[2:])
    return (left + right) / 2 if abs(left - right) < _LEVEL_TOES_M else min(left, right)


def grounded(motion: Motion) -> Motion:
    """Put a motion, +Y up, on the floor y = 0: all frames are shifted by one height.

    It is `ground_height` in frame `motion.trim_start`: Lodge first trims a still beginning.

    Examples
    --------
    >>> from dancedata.core.ground import grounded
    >>> from dancedata.synthetic import synthesise_motion
    >>> motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0]
    >>> moved = grounded(motion)
    >>> bool(moved.joints()[0, :, 1].min() < 0.05)
    True
    """
    frame = motion.trim_start
    # Without the cache of the whole: one frame alone, for the same bits.
    height = ground_height(motion.part(frame, frame + 1).on(motion.skeleton).joints(), motion.skeleton)
    return replace(motion, translation=motion.translation - (0.0, height, 0.0))

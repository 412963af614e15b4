"""The body of a figure: how tall it stands and where its floor is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton

BoolArray = npt.NDArray[np.bool_]
#: Height of a standing body that lengths of body parts are for, metres.
TALL = 1.7
#: Height of the joint of a toe above its sole, for such a body: SMPL's lies 2 to 3 cm above it.
_TOE_M = 0.025
#: Share of contacts of the toes below which the feet themselves decide the floor.
_LEAST_CONTACT = 0.05
#: Quantile of the heights of the feet that decides then: a foot that sinks in for a few frames does not lower it.
_LOW = 0.02
#: A still toe higher than this above that quantile does not stand, for such a body, metres: legs of one who lies.
_STANDS_M = 0.2


def standing_height(pose: Float64Array, skeleton: Skeleton) -> float:
    """Return the height of a body that stands, metres: its bones from a toe to the root and on to the head."""
    length = np.zeros(skeleton.n_joints)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            length[joint] = length[parent] + float(np.linalg.norm(pose[joint] - pose[parent]))
    paired = {joint for pair in skeleton.pairs for joint in pair}
    middle = max(float(length[joint]) for joint in range(skeleton.n_joints) if joint not in paired)
    return max(0.05, 0.98 * (float(length[skeleton.feet[2]]) + middle))


def lowest_feet(joints: Float64Array, feet: Sequence[int]) -> float:
    """Return the 2 % quantile of the heights of foot joints over (T, J, 3) joints, metres."""
    return float(np.quantile(joints[:, list(feet), 1], _LOW))


def floor_height(
    joints: Float64Array, contacts: BoolArray, contact_joints: Sequence[int], skeleton: Skeleton
) -> float:
    """Return the height of the floor, metres: the soles lie on it while the toes are in contact.

    The median height of the joints of toes in contact, less their height above the sole. Where toes are in contact in
    fewer than 5 % of the frames, the 2 % quantile of the heights of the feet, less the same.

    `joints`: (T, J, 3), metres, +Y up.
    `contacts`, `contact_joints`: (T, C) labels, and the joints that they are for.
    """
    scale = standing_height(joints[0], skeleton) / TALL
    low = lowest_feet(joints, skeleton.feet)
    toes = [k for k, joint in enumerate(contact_joints) if joint in skeleton.feet[2:]]
    heights = joints[:, [contact_joints[k] for k in toes], 1]
    standing = contacts[:, toes] & (heights < low + _STANDS_M * scale)
    enough = standing.size and standing.mean() >= _LEAST_CONTACT
    return (float(np.median(heights[standing])) if enough else low) - _TOE_M * scale

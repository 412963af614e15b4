"""LDA's 61 columns."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import MOTORICA21
from dancedata.core.columns import Columns, Group, Mirror, Spatial
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import Float64Array, matrix_from_rotvec, rotvec_from_matrix
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.representations import _columns as parts
from dancedata.representations._columns import Part

#: Joints of the columns in their order: Motorica's backwards, without the toes.
_JOINTS = tuple(j for j, name in reversed(list(enumerate(MOTORICA21.joints))) if not name.endswith("ToeBase"))
_ROTATIONS = 3 * len(_JOINTS)
_OTHER = MOTORICA21.other_side
_PERMUTATION = tuple(3 * _JOINTS.index(_OTHER.get(j, j)) + axis for j in _JOINTS for axis in range(3))
_LABELS = tuple(f"{MOTORICA21.joints[j]}.{axis}" for j in _JOINTS for axis in "xyz")
_PARTS = (
    Part(Group("axis_angle", _ROTATIONS, "rad", _LABELS), Mirror(_PERMUTATION, (1, -1, -1) * len(_JOINTS))),
    Part(Group("root_height", 1, "cm"), Mirror((0,), (1,))),
    Part(Group("root_way", 2, "cm per frame", ("x", "z")), Mirror((0, 1), (-1, 1))),
    Part(Group("root_turn", 1, "rad per frame"), Mirror((0,), (-1,))),
)
#: Below this sine of its angle to the vertical, the side axis of the hips has no direction on the floor.
_LEAST = 1e-6


@REPRESENTATIONS.register("lda61")
@dataclass(frozen=True)
class Lda61(Representation):
    """19 joint rotations as axis-angle, height of the hips, their way and turn per frame; 30 per second.

    The columns of "Listen, Denoise, Action!" (LDA, Alexanderson et al. 2023). The hips are turned so that each frame
    faces +Z, by their side axis; way and turn lead to a frame from the one before, the way as the frame faces. The
    first row has the way of the second in the world, and its turn. Lengths are centimetres. Mirroring reflects across
    the plane x = 0.

    Lost are the toes' rotations, the fingers, the bones of the recording, and place and facing of the first frame.
    """

    skeleton: ClassVar[Skeleton] = MOTORICA21
    columns: ClassVar[Columns] = parts.columns_of(*_PARTS)
    axes: ClassVar[str] = "right-handed, +Y up, centimetres, each frame facing +Z"
    rate: ClassVar[Fraction | None] = Fraction(30)
    spatial: ClassVar[Spatial | None] = Spatial("y", {part.group.name: "unchanged" for part in _PARTS})

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        """Encode a motion with Motorica's joints; axis-angle vectors have a length of at most pi."""
        parts.refuse_rule(contacts, self.name)
        skeleton = motion.skeleton
        names = [MOTORICA21.joints[j] for j in _JOINTS]
        missing = [name for name in names if name not in skeleton.joints]
        if missing:
            raise UsageError(
                f"{self.name} needs the joints of Motorica",
                found=f"skeleton {skeleton.name} without {listed(missing, 3)}",
                allowed=listed(names, 6),
                fix="for bodies of the SMPL family choose edge151 or another of their representations",
            )
        matrices = motion.matrices[:, [skeleton.index(name) for name in names]]
        side = -matrices[:, -1, :, 0]
        forward = parts.on_floor(np.stack([side[:, 2], -side[:, 0]], axis=1), _LEAST)
        yaw = np.arctan2(forward[:, 0], forward[:, 1])
        matrices[:, -1] = _turns(-yaw) @ matrices[:, -1]
        places = (motion.translation + skeleton.offsets[0]) * 100
        way, turn = np.zeros((motion.n_frames, 3)), np.zeros(motion.n_frames)
        if motion.n_frames > 1:
            way[1:, (0, 2)] = np.diff(places[:, (0, 2)], axis=0)
            turn[1:] = np.diff(yaw)
            way[0], turn[0] = way[1], turn[1]
        way = np.einsum("tab,tb->ta", _turns(-yaw), way)
        turn = np.pi - (np.pi - turn) % (2 * np.pi)
        rotations = rotvec_from_matrix(matrices).reshape(motion.n_frames, -1)
        return np.column_stack([rotations, places[:, 1], way[:, (0, 2)], turn]).astype(np.float32)

    @override
    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode (T, 61) columns into a motion on Motorica's usual bones.

        The dance begins above the origin, facing +Z; toes do not turn. Way and turn of the first row are not read.
        """
        numbers = parts.checked(array, _ROTATIONS + 4, self.name)
        yaw = np.concatenate([[0.0], np.cumsum(numbers[1:, -1])])
        way = np.einsum("tab,tb->ta", _turns(yaw), np.insert(numbers[:, 58:60], 1, 0.0, axis=1))
        way[0] = 0
        translation = np.cumsum(way, axis=0) / 100 - MOTORICA21.offsets[0]
        translation[:, 1] += numbers[:, 57] / 100
        rotations = np.zeros((len(numbers), MOTORICA21.n_joints, 3))
        matrices = matrix_from_rotvec(numbers[:, :_ROTATIONS].reshape(len(numbers), -1, 3))
        matrices[:, -1] = _turns(yaw) @ matrices[:, -1]
        rotations[:, list(_JOINTS)] = rotvec_from_matrix(matrices)
        return Motion(translation, rotations, grid, MOTORICA21)


def _turns(yaw: Float64Array) -> Float64Array:
    """Return turns about +Y, (T, 3, 3), by angles (T,)."""
    return matrix_from_rotvec(np.stack([np.zeros_like(yaw), yaw, np.zeros_like(yaw)], axis=1))

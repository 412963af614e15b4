"""EDGE's 151 columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.kinematics import forward_kinematics
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import (
    Float64Array,
    matrix_from_6d,
    matrix_from_rotvec,
    rotation_6d,
    rotvec_from_matrix,
)
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE, Skeleton

#: +Y up to +Z up: a quarter turn about x, (x, y, z) -> (x, -z, y).
_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_N_JOINTS = 24
_WIDTH = 4 + 3 + 6 * _N_JOINTS


@REPRESENTATIONS.register("edge151")
@dataclass(frozen=True)
class Edge151:
    """Contacts 4, root translation 3, 24 joint rotations in 6D; the world turned to +Z up (EDGE, section 3.2).

    The columns hold SMPL's translation, which EDGE takes for the pelvis: its forward kinematics, and so the
    contacts, leave out the pelvis's rest position. That shifts all joints alike and changes no speed.
    6D is the first two rows of each matrix. Mirroring reflects across the plane x = 0.
    """

    version: ClassVar[int] = 1
    default_contacts: ClassVar[str | None] = "velocity"
    skeleton: ClassVar[Skeleton] = SMPL24
    axes: ClassVar[str] = "right-handed, +Z up, metres"
    rotation_6d: ClassVar[str | None] = "first two rows of the matrix, flattened (pytorch3d)"

    @property
    def columns(self) -> Columns:
        """The 151 columns."""
        joints = SMPL24.joints
        parts = tuple(f"{joint}.{row}{axis}" for joint in joints for row in (0, 1) for axis in "xyz")
        return Columns(
            (
                Group("contact", 4, "1", tuple(joints[j] for j in SMPL24.feet)),
                Group("translation", 3, "m", ("x", "y", "z")),
                Group("rotation_6d", 6 * _N_JOINTS, "1", parts),
            ),
            mirror=_mirror(),
        )

    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        """Encode a motion.

        Parameters
        ----------
        motion
            On the 24 SMPL joints, +Y up.
        contacts
            Rule for the first four columns.

        Returns
        -------
        (T, 151) float32
        """
        if motion.skeleton.joints != SMPL24.joints:
            raise UsageError(
                "edge151 holds the 24 SMPL joints", found=f"skeleton {motion.skeleton.name}", allowed=SMPL24.name
            )
        if contacts is None:
            raise UsageError("edge151 needs a contact rule", allowed="a rule such as velocity")
        matrices = matrix_from_rotvec(motion.rotations)
        matrices[:, 0] = _Z_UP @ matrices[:, 0]
        translation = motion.translation @ _Z_UP.T
        out = np.empty((motion.n_frames, _WIDTH), dtype=np.float32)
        # Contacts need no turning of the world: speeds do not depend on it.
        joints = forward_kinematics(SMPL24_EDGE, motion.rotations, motion.translation)
        out[:, :4] = contacts(joints, motion.grid, SMPL24_EDGE)
        out[:, 4:7] = translation
        out[:, 7:] = rotation_6d(matrices).reshape(motion.n_frames, -1)
        return out

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode columns (T, 151), not normalised, into a motion at the rate of `grid`, +Y up.

        Axis-angle vectors come back with a length of at most pi. Contacts are not part of a motion.

        Raises
        ------
        UsageError
            For another shape.
        DataError
            "nan", or "bad_rotation" where six columns span no plane.
        """
        array = np.asarray(array)
        if array.ndim != 2 or array.shape[1] != _WIDTH:
            raise UsageError("edge151 decodes (T, 151)", found=f"shape {array.shape}")
        # Before any arithmetic: infinity in it would warn first.
        if not np.isfinite(array[:, 4:]).all():
            raise DataError("the columns hold NaN or infinity", reason="nan", where="edge151")
        rows = array[:, 7:].astype(np.float64).reshape(len(array), _N_JOINTS, 6)
        _check_spans(rows)
        matrices = matrix_from_6d(rows)
        matrices[:, 0] = _Z_UP.T @ matrices[:, 0]
        return Motion(array[:, 4:7].astype(np.float64) @ _Z_UP, rotvec_from_matrix(matrices), grid, SMPL24)


def _check_spans(rows: Float64Array) -> None:
    spread = np.linalg.norm(np.cross(rows[..., :3], rows[..., 3:]), axis=-1)
    if (spread < 1e-6).any():
        frame, joint = np.argwhere(spread < 1e-6)[0]
        raise DataError(
            "six rotation columns span no plane, so they are no rotation",
            reason="bad_rotation",
            where=f"edge151, frame {frame}, {SMPL24.joints[joint]}",
            found=rows[frame, joint].tolist(),
            fix="decode columns that are not normalised: call the normaliser's unnormalize first",
        )


def _mirror() -> Mirror:
    """Swap sides and reflect across x = 0: R -> S R S with S = diag(-1, 1, 1) (FACT; Lodge)."""
    other = list(range(_N_JOINTS))
    for left, right in SMPL24.pairs:
        other[left], other[right] = right, left
    permutation = [1, 0, 3, 2, 4, 5, 6]
    signs = [1, 1, 1, 1, -1, 1, 1]
    for joint in range(_N_JOINTS):
        permutation += [7 + 6 * other[joint] + k for k in range(6)]
        # Of the first two rows, S R S negates the entries of row x or column x, not of both.
        signs += [1, -1, -1, -1, 1, 1]
    return Mirror(tuple(permutation), tuple(signs))

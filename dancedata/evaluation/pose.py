"""A dance as evaluation reads it: joint positions with names and a rate, and its rotations where they are known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import BODY_JOINTS, SMPLX52, SMPLX55, carried_over, has_body
from dancedata.core.dance import checked_joints
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed
from dancedata.evaluation.protocol import MotionRule

__all__ = ["BODIES", "Pose", "in_axes", "interpolated"]

#: Names of the joints of arrays (T, J, 3), by what they are called, and whether the pelvis is the body's own.
BODIES: dict[str, tuple[tuple[str, ...], bool]] = {
    "smpl24": (SMPL24.joints, True),
    "smpl24-edge": (SMPL24.joints, False),
    "smplx22": (BODY_JOINTS, True),
    "smplx24": (SMPLX55.joints[:24], True),
    "smplx52": (SMPLX52.joints, True),
    "smplx55": (SMPLX55.joints, True),
}
#: What an array is taken for by its number of joints where nothing is declared. Of 24 joints the pelvis is unknown.
BODY_OF = {22: "smplx22", 24: "smpl24-edge", 52: "smplx52", 55: "smplx55"}
_WANTED = {"smpl24": SMPL24.joints, "smplx24": SMPLX55.joints[:24], "body22": BODY_JOINTS}


@dataclass(frozen=True, eq=False)
class Pose:
    """One clip in canonical axes: metres, +Y up.

    Attributes
    ----------
    joints
        (T, J, 3) float64.
    names
        Names of the J joints.
    grid
        Rate of the frames.
    true_pelvis
        Whether the pelvis lies where the body has it.
    motion
        Root and rotations, where they are known.
    """

    joints: Float64Array
    names: tuple[str, ...]
    grid: FrameGrid
    true_pelvis: bool = True
    motion: Motion | None = None

    @property
    def rest(self) -> Float64Array:
        """Rest position of the pelvis, (3,): of the motion's body, else of SMPL's."""
        skeleton = SMPL24 if self.motion is None else self.motion.skeleton
        return np.asarray(skeleton.offsets[0], dtype=np.float64)

    @classmethod
    def of_motion(cls, motion: Motion) -> Pose:
        """Make the pose of a motion, on its own bones."""
        return cls(motion.joints(), motion.skeleton.joints, motion.grid, motion=motion)

    @classmethod
    def of_joints(cls, joints: npt.ArrayLike, grid: FrameGrid, body: str | None = None) -> Pose:
        """Make the pose of joint positions (T, J, 3), metres, +Y up.

        Raises
        ------
        DataError
            "bad_shape", "empty", "nan" or "missing_joints".
        """
        positions = checked_joints(joints)
        name = body or BODY_OF.get(positions.shape[1], "")
        known = BODIES.get(name)
        if known is None or len(known[0]) != positions.shape[1]:
            wanted = ", ".join(f"{k} ({len(v[0])} joints)" for k, v in BODIES.items())
            raise DataError(
                "the joints of an array are unknown",
                reason="missing_joints",
                found=f"{positions.shape[1]} joints" + (f", declared as {body}" if body else ""),
                allowed=wanted,
                fix="declare the body: --body NAME",
            )
        return cls(positions, known[0], grid, known[1])

    def conformed(self, rule: MotionRule) -> tuple[Pose, tuple[str, ...]]:
        """Return the joints and the rate that a protocol measures, +Y up, and notes on what was changed.

        Raises
        ------
        DataError
            "missing_joints", "other_pelvis" or "other_rate".
        """
        placed, notes = self._on(rule)
        if rule.pelvis == "translation" and placed.true_pelvis:
            placed = replace(placed, joints=placed.joints - placed.rest, true_pelvis=False, motion=None)
        if rule.pelvis == "body" and not placed.true_pelvis:
            raise DataError(
                "the protocol needs the true position of the pelvis",
                reason="other_pelvis",
                found="joints whose pelvis may lie at the translation, as in EDGE's kinematics",
                allowed="rotations and translation, or joints with the pelvis of the body",
                fix="declare the body if the pelvis is right: --body smpl24",
            )
        grid = rule.grid
        if grid is None or grid == placed.grid:
            return placed, notes
        step = placed.grid.step_to(grid)
        if step is None:
            raise DataError(
                "the protocol measures another frame rate",
                reason="other_rate",
                found=f"{placed.grid} frames per second",
                allowed=f"{grid}, or a whole multiple of it",
                fix="build the dataset, or generate, at that rate; the protocol dancedata takes any rate",
            )
        return replace(placed, joints=placed.joints[::step], grid=grid, motion=None), (
            *notes,
            f"{placed.grid} frames per second: every {step}. frame is measured",
        )

    def _on(self, rule: MotionRule) -> tuple[Pose, tuple[str, ...]]:
        wanted = _WANTED[rule.body]
        if rule.body == "smplx24" and self.motion is not None:
            return self._on_smplx()
        if rule.body == "smpl24" and self.motion is not None and has_body(self.motion.skeleton):
            placed = carried_over(self.motion, SMPL24)
            note = (
                () if placed is self.motion else (f"{self.motion.skeleton.name}: carried over to SMPL's 24 joints",)
            )
            return Pose.of_motion(placed), note
        if self.names[: len(wanted)] != wanted:
            raise self._missing(rule)
        return replace(self, joints=self.joints[:, : len(wanted)], names=wanted, motion=None), ()

    def _on_smplx(self) -> tuple[Pose, tuple[str, ...]]:
        """Return SMPL-X's first 24 joints; a motion without face joints has them at rest, as in Lodge."""
        motion = self.motion
        if motion is None or motion.skeleton.joints == SMPL24.joints or not has_body(motion.skeleton):
            raise self._missing(MotionRule("smplx24", None))
        own = carried_over(motion, SMPLX55)
        return Pose(own.joints()[:, :24], own.skeleton.joints[:24], own.grid), ()

    def _missing(self, rule: MotionRule) -> DataError:
        wanted = _WANTED[rule.body]
        lacking = [joint for joint in wanted if joint not in self.names]
        return DataError(
            "the protocol measures joints that this motion does not have",
            reason="missing_joints",
            found=f"{len(self.names)} joints, without {listed(lacking) or 'the same order'}",
            allowed=f"{rule.body}: {listed(wanted, 4)}",
            fix="evaluate motion on that body: SMPL-X for Lodge's protocol, SMPL's 24 joints for those of AIST++",
        )


def in_axes(joints: Float64Array, rule: MotionRule) -> Float64Array:
    """Return +Y-up positions in the axes of a protocol: for z up, (x, y, z) becomes (x, -z, y)."""
    if rule.up == "z":
        joints = np.stack([joints[..., 0], -joints[..., 2], joints[..., 1]], axis=-1)
    if rule.turned:
        joints = np.stack([-joints[..., 1], joints[..., 0], joints[..., 2]], axis=-1)
    return joints


def interpolated(joints: Float64Array, grid: FrameGrid, target: FrameGrid) -> Float64Array:
    """Return positions (T, J, 3) at another rate, linearly interpolated, from the same first frame."""
    if grid == target:
        return joints
    own, new = grid.common_period(target)
    frames = np.arange(grid.resampled_length(len(joints), target), dtype=np.float64) * own / new
    lower = np.minimum(frames.astype(np.int64), max(len(joints) - 2, 0))
    upper = np.minimum(lower + 1, len(joints) - 1)
    share = (frames - lower)[:, None, None]
    return np.asarray(joints[lower] * (1 - share) + joints[upper] * share)

"""Poses as a protocol measures them: its joints, its pelvis, its rate, its axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dancedata.core.bodies import BODY_JOINTS, SMPLX55, carried_over, has_body
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed
from dancedata.evaluation.protocol import MotionRule
from dancedata.representations.stored import Pose

__all__ = ["conformed", "in_axes", "interpolated"]

_WANTED = {"smpl24": SMPL24.joints, "smplx24": SMPLX55.joints[:24], "body22": BODY_JOINTS}


def conformed(pose: Pose, rule: MotionRule) -> tuple[Pose, tuple[str, ...]]:
    """Return the joints and the rate that a protocol measures, +Y up, and notes on what was changed.

    Raises
    ------
    DataError
        "missing_joints", "other_pelvis" or "other_rate".
    """
    placed, notes = _on(pose, rule)
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


def _on(pose: Pose, rule: MotionRule) -> tuple[Pose, tuple[str, ...]]:
    wanted = _WANTED[rule.body]
    if rule.body == "smplx24" and pose.motion is not None:
        return _on_smplx(pose)
    if rule.body == "smpl24" and pose.motion is not None and has_body(pose.motion.skeleton):
        placed = carried_over(pose.motion, SMPL24)
        note = () if placed is pose.motion else (f"{pose.motion.skeleton.name}: carried over to SMPL's 24 joints",)
        return Pose.of_motion(placed), note
    if pose.names[: len(wanted)] != wanted:
        raise _missing(pose, rule)
    return replace(pose, joints=pose.joints[:, : len(wanted)], names=wanted, motion=None), ()


def _on_smplx(pose: Pose) -> tuple[Pose, tuple[str, ...]]:
    """Return SMPL-X's first 24 joints; a motion without face joints has them at rest, as in Lodge."""
    motion = pose.motion
    if motion is None or motion.skeleton.joints == SMPL24.joints or not has_body(motion.skeleton):
        raise _missing(pose, MotionRule("smplx24", None))
    own = carried_over(motion, SMPLX55)
    return Pose(own.joints()[:, :24], own.skeleton.joints[:24], own.grid), ()


def _missing(pose: Pose, rule: MotionRule) -> DataError:
    wanted = _WANTED[rule.body]
    lacking = [joint for joint in wanted if joint not in pose.names]
    return DataError(
        "the protocol measures joints that this motion does not have",
        reason="missing_joints",
        found=f"{len(pose.names)} joints, without {listed(lacking) or 'the same order'}",
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

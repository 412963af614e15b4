"""Poses of columns, of a dataset or of samples, by the plug-ins that made them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import BODY_JOINTS, SMPLX52, SMPLX55
from dancedata.core.dance import checked_joints
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import Representation
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.formats.arrays import UNSTATED, StatedScaling
from dancedata.kernel import Store
from dancedata.scene.scaling import Scaling
from dancedata.store.motion_fields import stored_representation, stored_representations

_POSITION = "position"
_AS_STORED = Scaling()

#: By the name of a body: names of its joints in arrays (T, J, 3), and whether the pelvis is that of the body.
BODIES: dict[str, tuple[tuple[str, ...], bool]] = {
    "smpl24": (SMPL24.joints, True),
    "smpl24-edge": (SMPL24.joints, False),
    "smplx22": (BODY_JOINTS, True),
    "smplx24": (SMPLX55.joints[:24], True),
    "smplx52": (SMPLX52.joints, True),
    "smplx55": (SMPLX55.joints, True),
}
#: Body of an array without a declared one, by its number of joints. Of 24 joints the pelvis is unknown.
_BODY_OF = {22: "smplx22", 24: "smpl24-edge", 52: "smplx52", 55: "smplx55"}


@dataclass(frozen=True, eq=False)
class Pose:
    """One clip in canonical axes: metres, +Y up."""

    joints: Float64Array  # (T, J, 3) float64
    names: tuple[str, ...]
    grid: FrameGrid
    true_pelvis: bool = True  # whether the pelvis is where the body has it
    motion: Motion | None = None  # root and rotations, where they are known
    doubt: str = ""  # why it is doubtful that its columns were scaled as stated; "" where it is not

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
        """Make the pose of joint positions (T, J, 3), metres, +Y up."""
        positions = checked_joints(joints)
        name = body or _BODY_OF.get(positions.shape[1], "")
        joints_of_body = BODIES.get(name)
        if joints_of_body is None or len(joints_of_body[0]) != positions.shape[1]:
            bodies = ", ".join(f"{k} ({len(v[0])} joints)" for k, v in BODIES.items())
            raise DataError("the joints of an array are unknown", reason="missing_joints",
                            found=f"{positions.shape[1]} joints" + (f", declared as {body}" if body else ""),
                            allowed=bodies, fix="declare the body by its name")  # fmt: skip
        return cls(positions, joints_of_body[0], grid, joints_of_body[1])


def interpolated(joints: Float64Array, frames: Float64Array) -> Float64Array:
    """Return positions (N, J, 3) of (T, J, 3) at frames (N,) from 0 to T - 1, linear between whole ones."""
    lower = np.minimum(frames.astype(np.int64), max(len(joints) - 2, 0))
    upper = np.minimum(lower + 1, len(joints) - 1)
    share = (frames - lower)[:, None, None]
    return np.asarray(joints[lower] * (1 - share) + joints[upper] * share)


@dataclass(frozen=True, eq=False)
class ColumnsReader:
    """Turns (T, D) columns of a representation at a rate into a pose."""

    representation: Representation
    grid: FrameGrid
    scaling: Scaling = _AS_STORED

    def pose(self, columns: npt.NDArray[Any], *, file: StatedScaling = UNSTATED, where: object = None) -> Pose:
        """Return the pose of (T, D) columns; DataError "nan", "bad_rotation" or "bad_shape"."""
        plugin = self.representation
        rows = np.asarray(columns)
        if rows.ndim != 2 or rows.shape[1] != plugin.columns.width:
            raise DataError(f"these are not columns of {plugin.name}", reason="bad_shape", where=where,
                            found=f"shape {rows.shape}", allowed=f"(T, {plugin.columns.width})")  # fmt: skip
        rows, doubt = self.scaling.undone(rows, plugin, file=file, where=where)
        if plugin.decodes:
            try:
                return replace(Pose.of_motion(plugin.decode(rows, self.grid)), doubt=doubt)
            except DataError as error:
                error.where = ": ".join(str(place) for place in (where, error.where) if place is not None) or None
                raise
        positions = rows[:, plugin.columns.slice(_POSITION)].reshape(len(rows), -1, 3).astype(np.float64)
        return Pose(positions, plugin.skeleton.joints, self.grid, bool(plugin.skeleton.offsets[0].any()))


def motion_reader(store: Store, name: str) -> ColumnsReader:
    """Return the reader of a motion field; UsageError as `stored_representation`."""
    field = store.field(name)
    return ColumnsReader(stored_representation(store.info.get("recipe"), name, field.columns), field.grid)


def pose_readers(store: Store) -> dict[str, ColumnsReader]:
    """Return those of `motion_readers` that give positions of joints."""
    return {
        name: reader
        for name, reader in motion_readers(store).items()
        if reader.representation.decodes or _POSITION in reader.representation.columns.names
    }


def motion_readers(store: Store) -> dict[str, ColumnsReader]:
    """Return a reader of each motion field whose plug-in is installed, in the order of the dataset."""
    plugins = stored_representations(store).items()
    return {name: ColumnsReader(plugin, store.field(name).grid) for name, plugin in plugins}

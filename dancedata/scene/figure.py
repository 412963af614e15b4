"""The joints of a dancer over time, with the data for drawing them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SKELETONS, SMPLX55
from dancedata.core.dance import checked_joints
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import CONTACTS
from dancedata.core.rotations import Float64Array, slerp
from dancedata.core.skeleton import Skeleton
from dancedata.formats.body_mesh import BodyMesh, Float32
from dancedata.metrics.key_motion import KeyMotion, key_motion
from dancedata.scene.body import floor_height, lowest_feet, standing_height
from dancedata.scene.limbs import Limbs, chest_looks, looks, sides_of
from dancedata.scene.poses import ColumnsReader, Pose, interpolated
from dancedata.scene.turns import rest_pose, turns_of_bones

BoolArray = npt.NDArray[np.bool_]
#: Joints that the speed is a mean of: the body's, without fingers, jaw and eyes.
_BODY = 22
#: Metres; far larger numbers cannot be distinguished from the square of a distance that overflows.
_FARTHEST_M = 1e7


@dataclass(frozen=True, eq=False)
class Movement:
    """Speed and key motions of a dancer."""

    # (n,) mean speed of the joints, smoothed, metres per second; value k belongs to the instant (k + 1/2) / rate
    speed: Float64Array
    grid: FrameGrid
    key_times: Float64Array  # (M,) instants of the key motions, seconds
    prominence: Float64Array  # (M,) their depth, metres per second
    stored: str = ""  # name of the stored field; "" if they were computed from the figure

    @classmethod
    def of(cls, key: KeyMotion, grid: FrameGrid, stored: str = "") -> Movement:
        """Convert the curve and the minima of a key motion finder, metres per frame."""
        rate = float(grid.rate)
        times = np.asarray((key.minima + 0.5) / rate, dtype=np.float64)
        return cls(np.asarray(key.curve * rate), grid, times, np.asarray(key.prominence * rate), stored)


@dataclass(frozen=True, eq=False)
class Figure:
    """A dancer."""

    joints: Float64Array  # (T, J, 3) positions, metres, +Y up, read-only
    skeleton: Skeleton
    grid: FrameGrid
    contacts: BoolArray  # (T, 4) whether a foot joint, one of `contact_joints`, is on the ground
    contact_joints: tuple[int, ...]
    # whether they are those of the dataset; if not, they were computed by the rule "velocity"
    contacts_stored: bool = False
    # (T, 3) unit vectors in which the head faces; None where rotations are unknown
    facing: Float64Array | None = None
    # (T, J, 3) axis-angle of each joint in its parent's axes, radians; None where they are unknown
    rotations: Float64Array | None = None
    mesh: BodyMesh | None = None  # body model that is drawn, whose bones the figure has; None for limbs
    # the figure before it got these bones, of the same frames and place, which distances are measured on; None if it
    # has its own
    measured: Figure | None = None

    @classmethod
    def of_joints(cls, joints: Float64Array, skeleton: Skeleton, grid: FrameGrid) -> Figure:
        """Make the figure of joint positions (T, J, 3), metres, +Y up; contacts are computed (EDGE's rule)."""
        places = np.asarray(joints, dtype=np.float64)
        contacts = CONTACTS.make("velocity", {})(places, grid, skeleton) > 0.5
        return cls(places, skeleton, grid, contacts, skeleton.feet)

    @classmethod
    def of_pose(cls, pose: Pose, body: Skeleton, where: object) -> Figure:
        """Make the figure of a pose; `body` has the bones of positions whose names are those of its joints."""
        farthest = float(np.abs(pose.joints).max())
        if not farthest <= _FARTHEST_M:
            raise DataError("joint positions are too far away to be drawn", reason="out_of_range", where=str(where),
                            found=f"{farthest:g} m", allowed=f"at most {_FARTHEST_M:g} m, "
                            "of numbers in the unit that is stated")  # fmt: skip
        if pose.motion is not None:
            return cls._of_motion(pose.joints, pose.motion)
        skeleton = next((s for s in (body, *SKELETONS.values()) if s.joints == pose.names), None)
        return cls.of_joints(pose.joints, skeleton or SMPLX55.subset("part", pose.names), pose.grid)

    @classmethod
    def of_columns(cls, rows: npt.NDArray[np.generic], reader: ColumnsReader) -> Figure:
        """Make the figure of the (T, D) columns of a representation; DataError as `ColumnsReader.pose`."""
        pose = reader.pose(rows)
        checked_joints(pose.joints)
        skeleton = reader.representation.skeleton
        figure = cls.of_joints(pose.joints, skeleton, pose.grid)
        if pose.motion is not None:
            skeleton, figure = pose.motion.skeleton, cls._of_motion(pose.joints, pose.motion)
        columns = reader.representation.columns
        group = next((g for g in columns.groups if g.name in ("contact", "foot_contact") and g.width == 4), None)
        if group is None:
            return figure
        joints = tuple(skeleton.joints.index(part) for part in group.parts if part in skeleton.joints)
        order = joints if len(joints) == 4 else skeleton.feet
        stored = np.asarray(rows[:, columns.slice(group.name)], dtype=np.float64) > 0.5
        return replace(figure, contacts=stored, contact_joints=order, contacts_stored=True)

    @classmethod
    def _of_motion(cls, joints: Float64Array, motion: Motion) -> Figure:
        figure = cls.of_joints(joints, motion.skeleton, motion.grid)
        return replace(figure, facing=looks(motion), rotations=motion.rotations)

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return len(self.joints)

    @property
    def bones(self) -> tuple[tuple[int, int], ...]:
        """Pairs (parent, joint) of the J - 1 bones."""
        return tuple((parent, joint) for joint, parent in enumerate(self.skeleton.parents) if parent >= 0)

    @cached_property
    def sides(self) -> tuple[int, ...]:
        """Side of each joint: 0 in the middle, 1 left, 2 right."""
        return sides_of(self.skeleton)

    @cached_property
    def limbs(self) -> Limbs:
        """Girth of the bones."""
        return Limbs.of(self.joints[0], self.skeleton)

    @cached_property
    def look(self) -> Float64Array | None:
        """Where the head faces, (T, 3) unit vectors; where rotations are unknown, the chest. None without a head."""
        return self.facing if self.facing is not None else chest_looks(self.joints, self.skeleton)

    @cached_property
    def rest(self) -> Float64Array:
        """Joints at rest, (J, 3) metres, the root at 0."""
        return rest_pose(self.joints, self.skeleton, measured=self.rotations is None)

    @cached_property
    def turns(self) -> Float64Array:
        """Rotations of the joints, (T, J, 3); where they are unknown, those of the bones, without twist."""
        if self.rotations is not None:
            return self.rotations
        return turns_of_bones(self.joints, self.rest, self.skeleton)

    @cached_property
    def floor(self) -> float:
        """Height of the floor, metres: that of the soles while toes are in contact; see `floor_height`."""
        return floor_height(self.joints, self.contacts, self.contact_joints, self.skeleton)

    @cached_property
    def lowest(self) -> float:
        """The 2nd percentile of the heights of the feet, metres."""
        return lowest_feet(self.joints, self.skeleton.feet)

    @cached_property
    def tall(self) -> float:
        """Height of the dancer when standing, metres."""
        return standing_height(self.joints[0], self.skeleton)

    @cached_property
    def movement(self) -> Movement:
        """Speed and key motions of the body's joints (Lodge's curve and minima, on these joints)."""
        return Movement.of(key_motion(self.joints[:, :_BODY]), self.grid)

    @cached_property
    def sliding(self) -> float:
        """Mean horizontal speed of the foot joints in contact, metres per second; 0 without contact."""
        if self.measured is not None:
            return self.measured.sliding
        if self.n_frames < 2:
            return 0.0
        feet = self.joints[:, list(self.contact_joints)][..., [0, 2]]
        speed = np.linalg.norm(np.diff(feet, axis=0), axis=-1) * float(self.grid.rate)
        on = self.contacts[:-1] & self.contacts[1:]
        return float(speed[on].mean()) if on.any() else 0.0

    def part(self, begin: float, seconds: float) -> Figure:
        """Return the frames of a part of the time, fewer where the figure ends before; DataError if it has none."""
        first = round(begin * float(self.grid.rate))
        count = max(1, round(seconds * float(self.grid.rate)))
        frames = slice(first, first + count)
        if first >= self.n_frames:
            raise DataError("the motion ends before this part", reason="too_short",
                            found=f"{self.n_frames} frames at {self.grid} per second",
                            allowed=f"more than {first}")  # fmt: skip
        facing = None if self.facing is None else self.facing[frames]
        turns = None if self.rotations is None else self.rotations[frames]
        measured = None if self.measured is None else self.measured.part(begin, seconds)
        return replace(
            self, joints=self.joints[frames], contacts=self.contacts[frames], facing=facing, rotations=turns,
            measured=measured,
        )  # fmt: skip

    def shifted(self, by: npt.ArrayLike) -> Figure:
        """Return the figure moved by (3,) metres."""
        measured = None if self.measured is None else self.measured.shifted(by)
        return replace(self, joints=self.joints + np.asarray(by, dtype=np.float64), measured=measured)

    def mirrored(self) -> Figure:
        """Return the figure reflected across the plane x = 0, left and right exchanged."""
        order = np.arange(self.skeleton.n_joints)
        for left, right in self.skeleton.pairs:
            order[left], order[right] = right, left
        feet = [self.contact_joints.index(int(order[joint])) for joint in self.contact_joints]
        facing = None if self.facing is None else self.facing * (-1, 1, 1)
        turns = None if self.rotations is None else self.rotations[:, order] * (1, -1, -1)
        joints = self.joints[:, order] * (-1, 1, 1)
        contacts = self.contacts[:, feet]
        measured = None if self.measured is None else self.measured.mirrored()
        return replace(self, joints=joints, contacts=contacts, facing=facing, rotations=turns, measured=measured)

    def resampled(self, grid: FrameGrid, seconds: float, late: float = 0.0) -> Figure:
        """Return the figure at another rate and length, joints linear between frames; the last pose stays."""
        count = max(1, round(seconds * float(grid.rate)))
        begin = late * float(self.grid.rate)
        frames = np.clip(self.grid.places(count, grid) - begin, 0, self.n_frames - 1)
        joints, lower = interpolated(self.joints, frames), frames.astype(np.int64)
        facing = None if self.facing is None else self.facing[lower]
        turns = None if self.rotations is None else slerp(self.rotations, frames)
        contacts = self.contacts[lower]
        measured = None if self.measured is None else self.measured.resampled(grid, seconds, late)
        return replace(
            self, joints=joints, grid=grid, contacts=contacts, facing=facing, rotations=turns, measured=measured
        )

    def with_mesh(self, mesh: BodyMesh) -> Figure:
        """Return the figure as a body model, whose bones it then has; the pelvis stays where it is."""
        motion = self.motion
        if motion is None:
            raise UsageError("positions of joints do not turn a body model", found=self.skeleton.name,
                             fix="choose a motion field with rotations, or leave out the body model")  # fmt: skip
        motion = mesh.on(motion)
        feet = tuple(mesh.skeleton.index(self.skeleton.joints[joint]) for joint in self.contact_joints)
        return replace(
            self, joints=motion.joints(), skeleton=mesh.skeleton, contact_joints=feet, rotations=motion.rotations,
            mesh=mesh, measured=self.measured or self,
        )  # fmt: skip

    @property
    def motion(self) -> Motion | None:
        """Root and rotations; None where rotations are unknown."""
        if self.rotations is None:
            return None
        root = self.joints[:, 0] - self.skeleton.offsets[0]
        return Motion(root, self.rotations, self.grid, self.skeleton)

    def vertices(self, at: int) -> Float32 | None:
        """Return the vertices of the body model in a frame, (V, 3) metres, with pose correctives; None without."""
        if self.mesh is None:
            return None
        motion = self.part(at / float(self.grid.rate), 0.0).motion
        return None if motion is None else next(self.mesh.posed(motion))

    def distance_mm(self, other: Figure) -> Float64Array:
        """Return the mean distance to the joints of the same names of another figure, (T,) millimetres."""
        if self.measured is not None:
            return self.measured.distance_mm(other)
        other = other.measured or other
        names = [n for n in self.skeleton.joints if n in other.skeleton.joints]
        ours = self.joints[:, [self.skeleton.joints.index(n) for n in names]]
        theirs = other.joints[:, [other.skeleton.joints.index(n) for n in names]]
        distance = np.full(self.n_frames, np.nan)
        frames = other.grid.places(self.n_frames, self.grid)
        inside = frames <= len(theirs) - 1
        if not names or not inside.any():
            return distance
        at = interpolated(theirs, frames[inside])
        distance[inside] = np.linalg.norm(ours[inside] - at, axis=-1).mean(axis=-1) * 1000
        return distance

    def __repr__(self) -> str:
        return f"Figure({self.n_frames} frames at {self.grid} per second, {self.skeleton.n_joints} joints)"

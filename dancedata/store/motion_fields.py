"""Columns of a dataset's motion fields back to poses, by the plug-ins that its recipe names."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import BODY_JOINTS, SMPLX52, SMPLX55
from dancedata.core.columns import Columns
from dancedata.core.dance import checked_joints
from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation, SampleField
from dancedata.core.registry import CONTACTS, REPRESENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.store.queries import fields_with
from dancedata.store.row_queries import RowQueries
from dancedata.store.scaling import Scaling
from dancedata.store.schema import Field

#: End of the name of a field with the motion as it was before the recipe's repairs.
ORIGINAL = ".original"
_POSITION = "position"
_AS_STORED = Scaling()
#: Windows hold the same motion if joints are this near in the frames that they share, metres; columns are float32.
_SAME_M = 1e-4
#: Keys of a motion field in a recipe that are not parameters of its representation.
_NOT_OF_PLUGIN = ("contacts", "optional")

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
BODY_OF = {22: "smplx22", 24: "smpl24-edge", 52: "smplx52", 55: "smplx55"}


def _entry(recipe: object, field: str) -> dict[str, Any]:
    """Return a recipe's entry of a motion field; empty for anything else."""
    motion = recipe.get("motion") if isinstance(recipe, Mapping) else None
    # A field with the motion before repairs has the parameters of the repaired one.
    entry = motion.get(field, motion.get(field.removesuffix(ORIGINAL))) if isinstance(motion, Mapping) else None
    return dict(entry) if isinstance(entry, Mapping) else {}


def stored_representation(recipe: object, field: str, columns: Columns) -> Representation:
    """Return the plug-in that made the columns of a motion field, with the parameters of the dataset's recipe.

    Without an entry for the field, PLUGIN or PLUGIN.NAME, the plug-in has its default parameters. `columns` are those
    that are stored: a dataset may come from elsewhere. UsageError if no installed plug-in makes them, with the
    reason.
    """
    parameters = {key: value for key, value in _entry(recipe, field).items() if key not in _NOT_OF_PLUGIN}
    try:
        representation = REPRESENTATIONS.make(REPRESENTATIONS.split(field)[0], parameters)
        if representation.columns.to_json() != columns.to_json():
            raise UsageError(f"the installed {representation.name} makes other columns")
    except (DanceDataError, TypeError, ValueError, LookupError, ArithmeticError, AttributeError) as error:
        raise UsageError(
            f"the columns of {field} cannot be read", found=str(error),
            fix="install the version of the plug-in that the dataset was built with",
        ) from error  # fmt: skip
    return representation


def stored_contacts(recipe: object, field: str) -> ContactRule | None:
    """Return the rule of a field's contact columns; None where the recipe names none, or none that is installed."""
    rules = _entry(recipe, field).get("contacts")
    if not isinstance(rules, Mapping) or len(rules) != 1:
        return None
    ((name, parameters),) = rules.items()
    try:
        return CONTACTS.make(str(name), parameters) if isinstance(parameters, Mapping) else None
    except (DanceDataError, TypeError, ValueError):
        return None


def sample_field(store: RowQueries, name: str) -> SampleField:
    """Return a field with the plug-ins that made it, if the dataset's recipe names installed ones."""
    field, recipe = store.field(name), store.info.get("recipe")
    plain = SampleField(name, field.kind, field.columns, field.grid)
    if field.kind != "motion":
        return plain
    try:
        representation, contacts = stored_representation(recipe, name, field.columns), stored_contacts(recipe, name)
    except UsageError:
        return plain
    if representation.default_contacts is not None and contacts is None:
        return plain
    return replace(plain, representation=representation, contacts=contacts)


@dataclass(frozen=True, eq=False)
class Pose:
    """One clip in canonical axes: metres, +Y up.

    `joints`: (T, J, 3) float64.
    `names`: Names of the J joints.
    `grid`: Rate of the frames.
    `true_pelvis`: Whether the pelvis is where the body has it.
    `motion`: Root and rotations, where they are known.
    `doubt`: Why it is doubtful that its columns were scaled as stated; "" where it is not.
    """

    joints: Float64Array
    names: tuple[str, ...]
    grid: FrameGrid
    true_pelvis: bool = True
    motion: Motion | None = None
    doubt: str = ""

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

        DataError "bad_shape", "empty", "nan" or "missing_joints".
        """
        positions = checked_joints(joints)
        name = body or BODY_OF.get(positions.shape[1], "")
        joints_of_body = BODIES.get(name)
        if joints_of_body is None or len(joints_of_body[0]) != positions.shape[1]:
            bodies = ", ".join(f"{k} ({len(v[0])} joints)" for k, v in BODIES.items())
            raise DataError("the joints of an array are unknown", reason="missing_joints",
                            found=f"{positions.shape[1]} joints" + (f", declared as {body}" if body else ""),
                            allowed=bodies, fix="declare the body: --body NAME")  # fmt: skip
        return cls(positions, joints_of_body[0], grid, joints_of_body[1])


@dataclass(frozen=True, eq=False)
class ColumnsReader:
    """Turns (T, D) columns into a pose.

    `representation`: Plug-in of the columns.
    `grid`: Rate of the rows.
    `scaling`: Whether columns are normalised, and by which scaler.
    """

    representation: Representation
    grid: FrameGrid
    scaling: Scaling = _AS_STORED

    def pose(self, columns: npt.NDArray[Any], *, file: bool | None = None, where: object = None) -> Pose:
        """Return the pose of (T, D) columns; DataError "nan", "bad_rotation" or "bad_shape".

        `file` is what their file states of normalising; UsageError as `Scaling.undo`.
        """
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


def motion_reader(store: RowQueries, name: str) -> ColumnsReader:
    """Return the reader of a motion field; UsageError as `stored_representation`."""
    return _reader(store, store.field(name))


def _reader(store: RowQueries, field: Field) -> ColumnsReader:
    return ColumnsReader(stored_representation(store.info.get("recipe"), field.name, field.columns), field.grid)


def clip_pose(store: RowQueries, clip_id: str, field: str = "") -> Pose:
    """Return the pose of a whole clip, by the field that is named, else by the first with rotations, else positions.

    UsageError as `stored_representation`, and for a dataset without such a field.
    """
    field, reader = _reader_of_clip(store, clip_id, field)
    return reader.pose(store._read_clip(clip_id, field), where=clip_id)


def _reader_of_clip(store: RowQueries, clip_id: str, field: str) -> tuple[str, ColumnsReader]:
    if field:
        return field, motion_reader(store, field)
    kept = {name: reader for name, reader in pose_readers(store).items() if store._has_field(clip_id, name)}
    if not kept:
        raise UsageError("the dataset has no field of motion that can be decoded", where=str(store.path),
                         found=", ".join(store.fields))  # fmt: skip
    return min(kept.items(), key=lambda item: not item[1].representation.decodes)


def clip_motion(store: RowQueries, clip_id: str, field: str = "") -> Motion:
    """Return the motion of a whole clip; UsageError as `clip_pose`, and for a field without rotations."""
    return _with_rotations(clip_pose(store, clip_id, field), store, field)


def _with_rotations(pose: Pose, store: RowQueries, field: str) -> Motion:
    if pose.motion is None:
        raise UsageError("the field has no rotations", where=str(store.path),
                         found=field or "fields of positions alone", fix="take clip.joints()")  # fmt: skip
    return pose.motion


def pose_readers(store: RowQueries) -> dict[str, ColumnsReader]:
    """Return those of `motion_readers` that give positions of joints."""
    return {
        name: reader
        for name, reader in motion_readers(store).items()
        if reader.representation.decodes or _POSITION in reader.representation.columns.names
    }


def motion_readers(store: RowQueries) -> dict[str, ColumnsReader]:
    """Return a reader of each motion field whose plug-in is installed, in the order of the dataset."""
    readers = {}
    for field in fields_with(store, kind="motion"):
        with suppress(UsageError):  # `motion_reader` of this field raises the reason
            readers[field.name] = _reader(store, field)
    return readers

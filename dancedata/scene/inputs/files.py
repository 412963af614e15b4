"""Files of generated motion: columns of a representation, joint positions, SMPL arrays, BVH."""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.bodies import changes_body
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid, as_rate
from dancedata.core.registry import DATASETS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.files.documents import document_of
from dancedata.formats.arrays import ArrayFile, stated_scaling
from dancedata.formats.stated import (
    JOINT_NAMES,
    PERSON_MASK,
    RATE_KEYS,
    UNITS,
    UPRIGHT,
    metres,
    same_rate,
    stated_grid,
)
from dancedata.formats.values import open_arrays
from dancedata.formats.video_tracks import people_of
from dancedata.kernel import Cache, Store
from dancedata.scene.inputs.clip import ClipInput, columns_identity
from dancedata.scene.inputs.naming import motion_files, motion_paths
from dancedata.scene.poses import ColumnsReader, Pose, motion_readers

#: Names of arrays (T, J, 3) that are taken as positions; "" is the only array of a file.
_JOINTS = ("full_pose", "joints", "positions", "keypoints3d", "")
_COLUMNS = ("columns", "motion", "samples", "")
_LEAST_JOINTS = 22
#: Fixes for files with rotations, by reason.
_REMEDIES = {
    "undeclared": "declare it: the rate (fps), up: y or z, the unit: m, cm, mm or inch",
    "unknown_joints": "name the joints in the file: numpy.savez(file, positions=..., joint_names=[...])",
    "missing_key": "name its arrays so, or say what the columns are and of which dataset: field, like",
}


#: A dancer of a group that has a file each: NAME_00, NAME_p0 or ID~p0.
_DANCER = re.compile(r"(.+)(?:_(\d\d)|[_~]p(\d+))")


@dataclass(frozen=True, eq=False)
class FileFormat:
    """Declarations about the files of a folder: rate, axis and unit are of those that do not state them."""

    fps: str | None = None
    up: str | None = None
    unit: str | None = None
    body: str | None = None  # body of positions (T, J, 3), a key of `BODIES`
    columns: ColumnsReader | None = None  # reader of two-dimensional arrays; None: they are refused
    groups: bool = False  # whether a file is a group of dancers: the arrays have an axis P more, the first

    def __post_init__(self) -> None:
        if self.up not in (None, *UPRIGHT):
            raise UsageError("invalid up axis", found=self.up, allowed=", ".join(UPRIGHT))
        if self.unit is not None and self.unit != "guess" and metres(self.unit) is None:
            allowed = f"{', '.join(UNITS)}, guess (for BVH), or a number"
            raise UsageError("invalid unit", found=self.unit, allowed=allowed)
        if self.fps is not None:
            as_rate(self.fps)

    def identity(self) -> list[Any]:
        """Return JSON data for cache keys."""
        columns = None if self.columns is None else columns_identity(self.columns)
        return [self.fps, self.up, self.unit, self.body, columns, *["groups"] * self.groups]

    @property
    def folder(self) -> Any:
        """The reader of files with rotations."""
        reader: Any = DATASETS.get("folder")
        return reader(fps=self.fps, up=self.up, unit=self.unit, music="optional")


@dataclass(frozen=True, kw_only=True, eq=False)
class FileClip(ClipInput):
    """A file with one clip, or one motion of a file that holds a batch."""

    path: Path
    format: FileFormat
    sample: int | None = None  # number of the motion in the batch; None: the file is one clip
    person: str = ""  # the file's own name for one of its people; "" for the only one
    # files of the other dancers of a group, where each dancer has a file; None where one file has all
    partners: tuple[Path, ...] | None = None

    @property
    @override
    def file(self) -> Path:
        return self.path

    @property
    @override
    def dancer_files(self) -> tuple[Path, ...]:
        return () if self.partners is None else (self.path, *self.partners)

    @override
    def changes_body(self, target: Skeleton) -> bool:
        return self.path.suffix.lower() != ".bvh" or changes_body(SMPL24, target)

    @override
    def identity(self, cache: Cache) -> Any:
        folder = self.format.folder
        declared = [self.format.identity(), folder.version, document_of(folder, loading=True)]
        if self.path.suffix.lower() != ".bvh":
            declared.append(RATE_KEYS)
        declared += [self.person] if self.person else [] if self.sample is None else [self.sample]
        partners = [[path.suffix.lower(), cache.file_sha256(path)] for path in self.partners or ()]
        return ["file", declared, self.path.suffix.lower(), cache.file_sha256(self.path), *partners]

    @override
    def load(self) -> Pose | tuple[Pose, ...]:
        if self.partners is not None:
            return tuple(replace(self, path=path, partners=None).pose() for path in (self.path, *self.partners))
        return tuple(map(self.as_stated, self._dancers())) if self.format.groups else self.pose()

    def pose(self) -> Pose:
        """Load a file of one dancer."""
        return self.as_stated(self._pose())

    def _pose(self) -> Pose:
        if self.path.suffix.lower() != ".bvh" and not self.person:
            with open_arrays(self.path) as arrays:
                if self.sample is None:
                    self._require_single(arrays)
                one = arrays if self.sample is None else _One(arrays, self.sample)
                pose = self._columns(one) or self._positions(one)
            if pose is not None:
                return pose
        try:
            person = (("person", self.person),) if self.person else ()
            ref = ClipRef(self.id, self.path, None, "test", declared=person)
            return Pose.of_motion(self.format.folder.load(ref))
        except DataError as error:  # the folder's remedies are keys of a recipe
            error.fix = _REMEDIES.get(error.reason, error.fix)
            if self.format.columns is not None and error.reason == "bad_shape" and error.allowed is not None:
                plugin = self.format.columns.representation
                error.allowed = f"(T, {plugin.columns.width}), columns of {plugin.name}; {error.allowed}"
            raise

    def _require_single(self, arrays: ArrayFile) -> None:
        """Raise DataError for the file of a group."""
        positions = [name for name in _JOINTS if name in arrays.names and len(_shape(arrays, name)) == 4]
        if positions or PERSON_MASK in arrays.names:
            raise DataError(
                "the file holds a group or several motions, but is read as one clip", reason="bad_shape",
                where=str(self.path), found=arrays.listed,
                fix="use a protocol for groups, such as groups; or save each dancer in a file",
            )  # fmt: skip

    def _dancers(self) -> tuple[Pose, ...]:
        """Return each dancer of a group's file that its `person_mask`, if it has one, does not leave out."""
        if self.path.suffix.lower() == ".bvh":
            raise _no_group(self.path, "a BVH file")
        folder, ref = self.format.folder, ClipRef(self.id, self.path, None, "test")
        poses = []
        with open_arrays(self.path) as whole:
            arrays = whole if self.sample is None else _One(whole, self.sample, masked=True)
            n = _n_dancers(arrays)
            present = arrays.read(PERSON_MASK).ravel() if PERSON_MASK in arrays.names else np.ones(n)
            if len(present) != n:
                raise DataError(f"{PERSON_MASK} does not match the dancers in the file", reason="bad_shape",
                                where=str(self.path), found=f"{len(present)} entries", allowed=f"{n}",
                                fix="save a file for each group, with an entry for each of its dancers")  # fmt: skip
            for number in np.flatnonzero(present):
                dancer = _One(arrays, int(number))
                pose = self._columns(dancer) or self._positions(dancer)
                try:
                    poses.append(pose or Pose.of_motion(folder.of_arrays(dancer, ref)))
                except DataError as error:
                    error.fix = _REMEDIES.get(error.reason, error.fix)
                    raise
        return tuple(poses)

    def _positions(self, arrays: ArrayFile) -> Pose | None:
        name = next((n for n in _JOINTS if n in arrays.names and _is_positions(arrays, n)), None)
        if name is None or _are_foreign(arrays):
            return None
        if self.format.up is None:
            raise self._undeclared("up axis of these positions", "--up y or --up z")
        factor = metres(self.format.unit or "m")
        if factor is None:
            raise self._undeclared("unit of these positions", "--unit m, cm or mm")
        upright = UPRIGHT[self.format.up]
        positions: Float64Array = arrays.read(name) * factor
        rotated = positions if self.format.up == "y" else np.asarray(positions @ upright.T)
        return Pose.of_joints(rotated, self._grid(arrays), self.format.body)

    def _columns(self, arrays: ArrayFile) -> Pose | None:
        reader = self.format.columns
        if reader is None:
            return None
        width = reader.representation.columns.width
        names = [n for n in _COLUMNS if n in arrays.names and _shape(arrays, n)[-1:] == (width,)]
        if len(names) > 1:
            raise DataError(f"several arrays have {width} columns", reason="bad_shape", where=str(self.path),
                            found=arrays.listed, fix="save one of them, or the other under another name")  # fmt: skip
        name = names[0] if names else None
        if name is not None and len(arrays.shape(name)) == 3:
            raise DataError("the array is a batch, but a file holds one clip", reason="bad_shape",
                            where=str(self.path), found=str(arrays.shape(name)), allowed=f"(T, {width})",
                            fix="save each clip to a file, or give the batch to dancedata.Evaluator")  # fmt: skip
        if name is None or len(arrays.shape(name)) != 2:
            return None
        stored = stated_grid(arrays)
        if not same_rate(stored, reader.grid):
            raise DataError("the frame rate of this file is not that of its columns", reason="bad_rate",
                            where=str(self.path), found=f"{stored} frames per second",
                            allowed=f"{reader.grid}, as fps or the dataset states")  # fmt: skip
        return reader.pose(arrays.read(name), file=stated_scaling(arrays), where=self.path)

    def _grid(self, arrays: ArrayFile) -> FrameGrid:
        stored = stated_grid(arrays)
        if stored is not None:
            return stored
        if self.format.fps is None:
            raise self._undeclared("frame rate of these positions", "--fps RATE, or --like DATASET")
        return FrameGrid.of(self.format.fps)

    def _undeclared(self, what: str, fix: str) -> DataError:
        return DataError(
            f"the {what} is unknown", reason="undeclared", where=str(self.path), fix=f"declare it: {fix}"
        )


class _One(ArrayFile):
    """The arrays of one dancer of a group's file, or of one motion or group (`masked`) of a batch."""

    def __init__(self, arrays: ArrayFile, number: int, *, masked: bool = False) -> None:
        super().__init__(arrays.path, tuple(name for name in arrays.names if masked or name != PERSON_MASK))
        self._arrays, self._number = arrays, number

    @override
    def shape(self, name: str) -> tuple[int, ...]:
        shape = self._arrays.shape(name)
        return shape[1:] if len(shape) > 2 else shape

    @override
    def read(self, name: str) -> Float64Array:
        array = self._arrays.read(name)
        return array[self._number] if array.ndim > 2 or name == PERSON_MASK else array

    @override
    def text(self, name: str) -> str:
        return self._arrays.text(name)

    @override
    def texts(self, name: str) -> tuple[str, ...]:
        return self._arrays.texts(name)


def _n_dancers(arrays: ArrayFile) -> int:
    """Return P of a group's file; DataError "bad_shape" for a file of one dancer."""
    shapes = {name: _shape(arrays, name) for name in arrays.names}
    of_group = {shape[0] for shape in shapes.values() if len(shape) > 2}
    one = any(name in _JOINTS and len(s) == 3 and s[1] >= _LEAST_JOINTS and s[2] == 3 for name, s in shapes.items())
    if one or len(of_group) != 1:
        raise _no_group(arrays.path, "; ".join(f"{name or 'the array'} {shape}" for name, shape in shapes.items()))
    return of_group.pop()


def _no_group(path: Path, found: str) -> DataError:
    return DataError(
        "the file is not of a group", reason="bad_shape", where=str(path), found=found,
        allowed="positions (P, T, J, 3), columns (P, T, D), or transl (P, T, 3), global_orient and body_pose",
        fix="save all dancers of a group in one file, or choose a protocol for single dancers",
    )  # fmt: skip


def _shape(arrays: ArrayFile, name: str) -> tuple[int, ...]:
    try:
        return arrays.shape(name)
    except DataError:
        if name and len(arrays.names) > 1:
            return ()  # such as the names of the joints
        raise


def _are_foreign(arrays: ArrayFile) -> bool:
    """Return whether a file names joints that are not in SMPL's order: the folder's reader maps them."""
    named = next(
        (names for key in JOINT_NAMES if key in arrays.names and (names := arrays.texts(key))), SMPL24.joints
    )
    return named[:_LEAST_JOINTS] != SMPL24.joints[:_LEAST_JOINTS]


def _is_positions(arrays: ArrayFile, name: str) -> bool:
    shape = _shape(arrays, name)
    return len(shape) == 3 and shape[1] >= _LEAST_JOINTS and shape[2] == 3


def path_clips(path: Path, form: FileFormat) -> tuple[ClipInput, ...]:
    """Return the motion files of a folder, or one file, a clip each; of groups as `_groups_of` finds them."""
    files = motion_files(path, "evaluate")
    if form.groups and path.is_dir():
        return _groups_of(files, form)
    return tuple(file_clip(file, form) for file in files)


def columns_width(path: Path) -> int:
    """Return the number of columns of a file; 0 if it holds none. DataError if it cannot be read."""
    with open_arrays(path) as arrays:
        name = next((name for name in _COLUMNS if name in arrays.names), None)
        shape = () if name is None else _shape(arrays, name)
    return shape[-1] if len(shape) in (2, 3) and shape[-1] > 3 else 0


def field_of_width(store: Store, of: Path | int) -> str | None:
    """Return the only motion field of a width, or of that of the first file of a path; None without one."""
    if isinstance(of, int):
        width = of
    else:
        file = next((file for file in motion_paths(of) if file.suffix.lower() in (".npy", ".npz")), None)
        try:
            width = 0 if file is None else columns_width(file)
        except (DataError, OSError):  # whose clip gives the reason
            return None
    widths = {name: store.field(name).columns.width for name in motion_readers(store)}
    fields = [name for name in widths if widths[name] == width]
    return fields[0] if len(fields) == 1 else None


def file_clip(path: Path, form: FileFormat) -> FileClip:
    """Return the clip of a file, with the id that an .npz file states of its motion."""
    stated = ""
    if path.suffix.lower() == ".npz":
        with suppress(DataError), open_arrays(path) as arrays:  # whose `load` gives the reason
            stated = arrays.text("id") if "id" in arrays.names else ""
    return FileClip(id=path.stem, path=path, format=form, stated_id=stated)


def _groups_of(paths: Sequence[Path], form: FileFormat) -> tuple[ClipInput, ...]:
    """Return the groups of files: each a group, or the dancers of one.

    Dancers are NAME_00, NAME_01, ..., as DD100 has them, or NAME_p0, NAME_p1, ..., or ID~p0 and so on, as `decode`
    writes those who are there.
    """
    dancers: dict[str, list[Path]] = {}
    for path in paths:
        named = _DANCER.fullmatch(path.stem)
        dancers.setdefault(named[1] if named else path.stem, []).append(path)
    groups: list[ClipInput] = []
    for name, files in dancers.items():
        numbers = {path: named for path in files if (named := _DANCER.fullmatch(path.stem))}
        decoded = [path in numbers and numbers[path][3] is not None for path in files]
        whole = [path for path in files if decoded == [False] or _is_group(path)]
        if len(whole) == len(files):
            groups += [clip for path in files for clip in _group_clips(path, form)]
            continue
        if whole:
            raise UsageError(f"files named like single dancers of {name} hold whole groups", where=files[0].parent,
                             found=listed([path.name for path in whole]),
                             allowed="one group in a file, or one dancer in a file",
                             fix="rename the files that hold groups")  # fmt: skip
        if all(decoded):
            files = sorted(files, key=lambda path: int(numbers[path][3]))
        elif any(decoded) or [numbers[path][2] for path in files] != [f"{k:02}" for k in range(len(files))]:
            raise UsageError("a dancer of a group is missing, or has two files", where=files[0].parent,
                             found=listed([path.name for path in files]),
                             allowed=f"{name}_00, {name}_01 and so on, or {name}_p0, {name}_p1")  # fmt: skip
        groups.append(replace(file_clip(files[0], form), id=name, stated_id="", partners=tuple(files[1:])))
    return tuple(groups)


def _group_clips(path: Path, form: FileFormat) -> tuple[FileClip, ...]:
    """Return the group of a file, or each of a batch, whose `person_mask` has a row for each."""
    try:
        with open_arrays(path) as arrays:
            is_batch = PERSON_MASK in arrays.names and len(_shape(arrays, PERSON_MASK)) > 1
    except DataError:
        is_batch = False
    return clips_of(path, form) if is_batch else (file_clip(path, form),)


def _is_group(path: Path) -> bool:
    """Return whether a file holds all dancers of a group."""
    try:
        with open_arrays(path) as arrays:
            return _n_dancers(arrays) > 0
    except DataError:
        return False


def clips_of(path: Path, form: FileFormat) -> tuple[FileClip, ...]:
    """Return the clips of a motion file: one, or one for each person, or motion of a batch of columns or positions.

    A file with an entry `person_mask` is a group, or a batch of groups. One that cannot be opened is a clip, whose
    `load` gives the reason.
    """
    one = (file_clip(path, form),)
    if path.suffix.lower() == ".bvh":
        return (replace(one[0], format=replace(form, unit=form.unit or "guess")),)
    try:
        people = people_of(path)
        if len(people) > 1:
            return tuple(replace(one[0], id=f"{path.stem}-person{person}", person=person) for person in people)
        with open_arrays(path) as arrays:
            if PERSON_MASK in arrays.names:
                group, mask = replace(one[0], format=replace(form, groups=True)), _shape(arrays, PERSON_MASK)
                return (group,) if len(mask) < 2 else _samples(group, mask[0])
            shapes = {name: _shape(arrays, name) for name in arrays.names}
    except DataError:
        return one
    width = None if form.columns is None else form.columns.representation.columns.width
    batches = [shapes[name][0] for name in _COLUMNS if len(shapes.get(name, ())) == 3 and shapes[name][2] == width]
    batches += [shapes[name][0] for name in _JOINTS if len(shapes.get(name, ())) == 4]
    if form.groups or not batches:
        return one
    return _samples(one[0], batches[0])


def _samples(clip: FileClip, n: int) -> tuple[FileClip, ...]:
    digits = max(3, len(str(n - 1)))
    return tuple(replace(clip, id=f"{clip.id}_{k:0{digits}}", sample=k) for k in range(n))

"""Files of programs that estimate body motion from video: WHAM, PHALP (4D-Humans) and GVHMR; and of MDM.

::

    WHAM    joblib: {person: {pose_world (T, 72), trans_world (T, 3), betas (T, 10), frame_ids (T,), pose, trans (in
            the camera's axes), verts}}. World axes: +Y up, metres (Shin et al. 2024)
    PHALP   joblib with zlib: {frame: {time, tid: [person], tracked_time: [0 if seen in this frame], smpl:
            [{global_orient (1, 3, 3), body_pose (23, 3, 3), betas (10,)}], camera: [(3,)]}}. Rotation matrices; the
            camera's axes: +Y down, +Z away from the camera (Rajasegaran et al. 2022)
    GVHMR   torch: {smpl_params_global: {global_orient (T, 3), body_pose (T, 63), transl (T, 3), betas (T, 10)}}. One
            person; +Y up (Shen et al. 2024)
    MDM     numpy.save of {motion (N, 22, 3, T) joint positions, lengths (N,), text, num_samples, ...}; each sample is
            divided as a person is. +Y up, metres, 20 FPS (Tevet et al. 2023)

Files of other programs that nest arrays by person as WHAM does are divided by people as well.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.text import counted, shown
from dancedata.formats.arrays import as_numbers
from dancedata.formats.safe_pickle import as_array
from dancedata.formats.values import ValueArrays, load_values

#: Programs whose files are recognised; what they write are rotations.
TOOLS = ("wham", "phalp", "gvhmr", "mdm")
#: More people than any video has.
MAX_PEOPLE = 1000
#: A person in a frame of PHALP takes more than 1,000 bytes, also compressed.
_LEAST_BYTES, _LEAST_DETECTIONS = 200, 5000
#: Names that PHALP's values of a person get here: (T, 24, 3, 3) and (T, 3).
PHALP_ROTATIONS, PHALP_CAMERA = "global_orient and body_pose", "camera"
_PHALP = ("tid", "smpl", "camera")
_WHAM = {"pose_world", "trans_world"}
_GVHMR = "smpl_params_global"
_MDM = {"motion", "lengths", "num_samples"}
_FRAMES = ("frame_ids", "frame_id")

Values = Mapping[Any, Any]


class PersonArrays(ValueArrays):
    """The arrays of one person of a file, or of a file as a whole (`person` "").

    `tool`: One of TOOLS, or "". `tracks`: The file's names for this person, if it has several, see `joined`.
    """

    def __init__(
        self, path: Path, values: object, person: str = "", tool: str = "", tracks: tuple[str, ...] = ()
    ) -> None:
        super().__init__(path, values)
        self.person = person
        self.tool = tool
        self.tracks = tracks

    @property
    def frames(self) -> NDArray[np.int64] | None:
        """(T,) numbers of the frames, as the file has them; DataError if they are not whole numbers."""
        name = next((name for name in _FRAMES if name in self.names), None)
        if name is None:
            return None
        values = self.read(name)
        if values.ndim != 1 or not (np.abs(values) < 1e9).all() or not (values == np.floor(values)).all():
            raise _invalid(self.path, f"{name} {values.shape}", "(T,) whole numbers")
        return values.astype(np.int64)

    def __str__(self) -> str:
        names = [name for name in _FRAMES if name in self.names]
        try:
            return f"{shown(self.person, 40)} ({counted(self.shape(names[0])[0], 'frame')})" if names else self.person
        except (DataError, IndexError):
            return shown(self.person, 40)


def open_people(path: Path) -> tuple[PersonArrays, ...]:
    """Read a file's people in its order, one without a name if it is not divided; DataError if unreadable."""
    stat = path.stat() if path.is_file() else None
    key = (path, stat.st_size, stat.st_mtime_ns) if stat is not None else None
    if key is not None and _last.key == key:
        return _last.people
    people = _divided(path, load_values(path), stat.st_size if stat is not None else 0)
    if people[0].tool == "phalp":
        # Thousands of opcodes for each second of video, and small once read.
        _last.key, _last.people = key, people
    return people


@dataclass
class _Last:
    """The file that was read last, where reading takes long."""

    key: tuple[Path, int, int] | None = None
    people: tuple[PersonArrays, ...] = field(default_factory=tuple)


_last = _Last()


def _divided(path: Path, content: object, size: int) -> tuple[PersonArrays, ...]:
    if not isinstance(content, Mapping):
        return (PersonArrays(path, content),)
    inner = content.get(_GVHMR)
    if isinstance(inner, Mapping):
        return (PersonArrays(path, inner, tool="gvhmr"),)
    if content.keys() >= _MDM:
        return tuple(_mdm(path, content))
    values = list(content.values())
    if not values or not all(isinstance(value, Mapping) for value in values):
        return (PersonArrays(path, content, tool="wham" if content.keys() >= _WHAM else ""),)
    if all(name in value for name in _PHALP for value in values):
        return tuple(_phalp(path, values, size))
    if len(content) > MAX_PEOPLE:
        raise _invalid(path, f"{len(content):,} people", f"at most {MAX_PEOPLE:,}")
    twice = [name for name in content if not isinstance(name, str) and str(name) in content]
    if twice:
        raise _invalid(path, f"two people {shown(str(twice[0]), 40)}, a number and a text", "one of each name")
    return tuple(
        PersonArrays(path, value, str(name), "wham" if value.keys() >= _WHAM else "")
        for name, value in content.items()
    )


def _mdm(path: Path, content: Values) -> Iterator[PersonArrays]:
    motion, lengths = as_array(content["motion"]), as_array(content["lengths"])
    if motion is None or motion.ndim != 4 or motion.shape[1:3] != (22, 3) or motion.dtype.kind not in "fiu":
        shape = None if motion is None else motion.shape
        raise _invalid(path, f"motion {shown(shape)}", "(N, 22, 3, T), HumanML3D's joints")
    if lengths is None or lengths.shape != motion.shape[:1] or not 0 < len(motion) <= MAX_PEOPLE:
        raise _invalid(path, f"{len(motion):,} samples", f"1 to {MAX_PEOPLE:,}, each with a length")
    for number, (sample, length) in enumerate(zip(motion, lengths.tolist(), strict=True)):
        positions = sample.transpose(2, 0, 1)[: max(int(length), 0)]
        yield PersonArrays(path, {"positions": positions}, str(number) if len(motion) > 1 else "", "mdm")


def _phalp(path: Path, frames: Sequence[Values], size: int) -> Iterator[PersonArrays]:
    """Collect the detections of each person over the frames; those that were not seen in a frame are predictions."""
    people: dict[str, list[tuple[int, Any, Any]]] = {}
    left = max(_LEAST_DETECTIONS, size // _LEAST_BYTES)
    for number, frame in enumerate(frames):
        ids, poses, cameras = (frame[name] for name in _PHALP)
        unseen = frame.get("tracked_time", [0] * len(ids) if isinstance(ids, list) else None)
        lists = (ids, poses, cameras, unseen)
        if any(type(items) is not list or len(items) != len(ids) for items in lists):
            raise _invalid(path, f"frame {number}: lists of different lengths", "one entry per person in each")
        left -= len(ids)
        if left < 0 or len(people) > MAX_PEOPLE:
            raise _invalid(path, "more people than a file of its size can hold", f"at most {MAX_PEOPLE:,}")
        time = frame.get("time", number)
        for person, pose, camera, late in zip(*lists, strict=True):
            if _whole(path, late) == 0:
                people.setdefault(str(_whole(path, person)), []).append((_whole(path, time), pose, camera))
    if not people:
        raise DataError("no person was detected in any frame", reason="empty", where=str(path),
                        found=counted(len(frames), "frame"),
                        fix="remove the file, or run the program on another video")  # fmt: skip
    for person, seen in sorted(people.items(), key=lambda item: int(item[0])):
        yield PersonArrays(path, _phalp_person(path, person, seen), person, "phalp")


def _phalp_person(path: Path, person: str, seen: list[tuple[int, Any, Any]]) -> dict[str, Any]:
    rotations = np.empty((len(seen), 24, 3, 3))
    cameras, betas = np.empty((len(seen), 3)), np.empty((len(seen), 10))
    for row, (_, pose, camera) in enumerate(seen):
        if not isinstance(pose, Mapping):
            raise _invalid(path, f"person {person}: smpl is {shown(pose)}", "a dict")
        rotations[row, 0] = _shaped(path, pose.get("global_orient"), (3, 3))
        rotations[row, 1:] = _shaped(path, pose.get("body_pose"), (23, 3, 3))
        betas[row] = _shaped(path, pose.get("betas"), (10,))
        cameras[row] = _shaped(path, camera, (3,))
    times = np.array([time for time, _, _ in seen])
    return {PHALP_ROTATIONS: rotations, PHALP_CAMERA: cameras, "betas": betas, "frame_ids": times}


def _shaped(path: Path, value: object, shape: tuple[int, ...]) -> NDArray[Any]:
    array = as_array(value) if value is not None else None
    if array is None or array.dtype.kind not in "fiu" or array.size != np.prod(shape):
        found = "nothing" if value is None else shown(value if array is None else array.shape)
        raise _invalid(path, found, f"numbers of shape {shape}")
    return as_numbers(array).reshape(shape)


def _whole(path: Path, value: object) -> int:
    if not isinstance(value, int | np.integer) or abs(int(value)) >= 1 << 31:
        raise _invalid(path, f"{shown(value)} for a person or a time", "a whole number")
    return int(value)


def _invalid(path: Path, found: str, allowed: str) -> DataError:
    return DataError(
        "the file is not as the program writes it",
        reason="bad_shape",
        where=str(path),
        found=found,
        allowed=allowed,
        fix="run the program again, or save each person's rotations and translation with numpy.savez",
    )

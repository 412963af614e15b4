"""Clips of any origin: motion in memory, of a source folder, of a built dataset, and groups of these."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import changes_body
from dancedata.core.clip import ClipRef, Window
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import sha256_bytes
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.skeleton import Skeleton
from dancedata.core.typing import override
from dancedata.files.documents import content_hashes, document_of
from dancedata.kernel import Cache, Store
from dancedata.scene.poses import ColumnsReader, Pose
from dancedata.store.dataset import reopen


@dataclass(frozen=True, kw_only=True, eq=False)
class ClipInput(ABC):
    """A clip, not loaded. It is small and picklable: units of work take it."""

    stored: ClassVar[bool] = False

    id: str  # unique among the clips of a set
    music: str = ""  # name of its song, empty if unknown
    tempo_bpm: float | None = None  # tempo of the song, where the dataset states one
    audio_start: Fraction = Fraction(0)  # second of the song at frame 0; negative where it begins later
    # unit of intervals: what copies, windows and parts of one file have in common; "": the clip itself
    recording: str = ""
    stated_id: str = ""  # id of the sample that its file states; "" if it states none
    length_s: Fraction | None = None  # length that its id states; None if it states none

    @property
    def clip(self) -> str:
        """Id of the clip that this one is a window of, or its own id."""
        return self.id

    @property
    def clips(self) -> tuple[str, ...]:
        """Ids of the clips that are read: of a group those of its dancers."""
        return (self.clip,)

    @property
    def file(self) -> Path | None:
        """File or folder that is read, which workers of a cluster have to see; None if the clip is in memory."""
        return None

    @property
    def dancer_files(self) -> tuple[Path, ...]:
        """Files of the dancers of a group that has one for each; none for others."""
        return ()

    def changes_body(self, target: Skeleton) -> bool:
        """Return whether the motion crosses to another body, see `bodies.changes_body`; True if that is unknown."""
        return True

    @abstractmethod
    def identity(self, cache: Cache) -> Any:
        """Return JSON data that changes when the motion does: a part of cache keys."""

    @abstractmethod
    def load(self) -> Pose | tuple[Pose, ...]:
        """Load the motion, of a group that of each dancer; DataError if it cannot be used."""

    def as_stated(self, pose: Pose) -> Pose:
        """Return a pose; DataError "wrong_length" unless it is as long as the id states."""
        grid, stated = pose.grid, self.length_s
        rows = None if stated is None else grid.rate * stated
        if rows is not None and not int(rows) <= len(pose.joints) <= math.ceil(rows):
            raise DataError("the motion is not as long as its id states", reason="wrong_length", where=self.id,
                            found=f"{len(pose.joints)} rows at {grid} per second",
                            allowed=f"{float(rows):g} rows, {float(stated or 0):g} s",
                            fix="a model at a different rate needs a dataset at that rate; for a longer dance, count "
                            "its frames in LENGTH of the id CLIP@START+LENGTH")  # fmt: skip
        return pose


@dataclass(frozen=True, kw_only=True, eq=False)
class MemoryClip(ClipInput):
    """Joint positions, or a motion, in memory."""

    motion: Motion | None = None
    joints: npt.NDArray[np.float64] | None = None
    grid: FrameGrid | None = None
    body: str | None = None

    @override
    def changes_body(self, target: Skeleton) -> bool:
        return self.motion is not None and changes_body(self.motion.skeleton, target)

    @override
    def identity(self, cache: Cache) -> Any:
        arrays: tuple[npt.NDArray[np.float64], ...]
        if self.motion is not None:
            skeleton, arrays = self.motion.skeleton, (self.motion.translation, self.motion.rotations)
            body: Any = [skeleton.name, list(skeleton.joints), skeleton.offsets.tolist(), str(self.motion.grid)]
        else:
            arrays, body = (np.asarray(self.joints, dtype=np.float64),), [self.body, str(self.grid)]
        return ["memory", body, [[list(a.shape), sha256_bytes(np.ascontiguousarray(a).tobytes())] for a in arrays]]

    @override
    def load(self) -> Pose:
        if self.motion is not None:
            return self.as_stated(Pose.of_motion(self.motion))
        if self.joints is None or self.grid is None:
            raise DataError("a clip without motion", reason="empty", where=f"clip {self.id}")
        return self.as_stated(Pose.of_joints(self.joints, self.grid, self.body))


@dataclass(frozen=True, kw_only=True, eq=False)
class DatasetClip(ClipInput):
    """A clip of a source folder, read by a dataset's reader at its own rate."""

    stored: ClassVar[bool] = True
    dataset: Dataset
    ref: ClipRef

    @property
    @override
    def file(self) -> Path:
        return self.ref.motion_path

    @override
    def changes_body(self, target: Skeleton) -> bool:
        return changes_body(self.dataset.body_of(self.ref), target)

    @override
    def identity(self, cache: Cache) -> Any:
        dataset, ref = self.dataset, self.ref
        content = content_hashes(dataset, cache.file_sha256)
        file = cache.file_sha256(ref.motion_path)
        reader = [dataset.name, dataset.version, document_of(dataset, loading=True), content]
        return ["dataset", reader, ref.id, [list(pair) for pair in ref.declared], file]

    @override
    def load(self) -> Pose:
        return Pose.of_motion(self.dataset.load(self.ref))


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupClip(ClipInput):
    """A group of dancers, each a clip; of a duet the follower first."""

    members: tuple[ClipInput, ...]

    @property
    def stored(self) -> bool:  # type: ignore[override]
        """Whether its dancers are those of a dataset."""
        return self.members[0].stored

    @property
    @override
    def clips(self) -> tuple[str, ...]:
        return tuple(member.clip for member in self.members)

    @property
    @override
    def file(self) -> Path | None:
        return self.members[0].file

    @override
    def changes_body(self, target: Skeleton) -> bool:
        return any(member.changes_body(target) for member in self.members)

    @override
    def identity(self, cache: Cache) -> Any:
        return ["group", [member.identity(cache) for member in self.members]]

    @override
    def load(self) -> tuple[Pose, ...]:
        loaded = (member.load() for member in self.members)
        return tuple(pose for pose in loaded if isinstance(pose, Pose))


@dataclass(frozen=True, kw_only=True, eq=False)
class StoreClip(ClipInput):
    """A clip of a store, or one of its windows, or the mirror image of it."""

    stored: ClassVar[bool] = True
    reference: tuple[str, str]  # path of the store and hash of its dataset.json
    field: str
    reader: ColumnsReader
    window: Window | None = None
    mirrored: bool = False

    @property
    @override
    def clip(self) -> str:
        return self.id if self.window is None else self.window.clip

    @property
    @override
    def file(self) -> Path:
        return Path(self.reference[0])

    @override
    def changes_body(self, target: Skeleton) -> bool:
        representation = self.reader.representation
        return representation.decodes and changes_body(representation.skeleton, target)

    @override
    def identity(self, cache: Cache) -> Any:
        rows = sha256_bytes(self._rows().tobytes())  # not the hash that dataset.json states
        return ["store", self.reference[1], self.id, self.field, columns_identity(self.reader), rows]

    @override
    def load(self) -> Pose:
        return self.reader.pose(self._rows())

    def _rows(self) -> npt.NDArray[Any]:
        store = _opened(*self.reference)
        if self.window is None:
            return store[self.id].read(self.field)
        rows = store.read(self.window, self.field)
        mirror = store.field(self.field).columns.mirror if self.mirrored else None
        return rows if mirror is None else mirror.apply(rows)


@lru_cache(maxsize=4)
def _opened(path: str, sha256: str) -> Store:
    return reopen(path, sha256)


def columns_identity(reader: ColumnsReader) -> list[Any]:
    """Return JSON data for cache keys that determines how columns are read."""
    plugin = reader.representation
    return [plugin.name, plugin.version, document_of(plugin), str(reader.grid), reader.scaling.identity()]

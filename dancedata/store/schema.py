"""Format 1 of the store: what is written, under which names. docs/store-format.md has the layout."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from types import MappingProxyType
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns
from dancedata.core.errors import StoreError
from dancedata.core.grid import as_rate
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import quoted

#: Version of the layout. A reader refuses every other.
FORMAT = 1
#: Every dataset's bytes start at a multiple of this, so that a mapped file gives aligned arrays.
ALIGNMENT = 64
#: The order in which splits are listed; others follow by name.
SPLIT_ORDER = ("train", "val", "test")
DATASET_FILE = "dataset.json"
STATS_FILE = "stats.json"
REJECTS_FILE = "rejects.jsonl"
QUALITY_FILE = "quality.jsonl"
CARD_FILE = "README.md"
#: Between the entries of /clips/lists.
LIST_SEPARATOR = "\n"

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*\Z")
_SHARD = re.compile(r"(?P<split>.+)-(?P<number>\d{5,})-of-(?P<total>\d{5,})\.h5\Z")

Kind = Literal["motion", "keymotion", "audio"]
Scope = Literal["track", "window"]
Order = Literal["time", "name"]


@runtime_checkable
class LazyArray(Protocol):
    """Anything with a shape that numpy can turn into an array: an ndarray, or a file opened on demand."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array, known without loading it."""
        ...

    def __array__(self) -> npt.NDArray[Any]:
        """Load the array."""
        ...


@dataclass(frozen=True)
class RowRate:
    """Rows of a field for each frame of the store, as an exact fraction num / den."""

    num: int
    den: int

    @classmethod
    def between(cls, rate: Fraction, fps: Fraction) -> RowRate:
        """Rows at `rate` for frames at `fps`, both a second."""
        ratio = rate / fps
        return cls(ratio.numerator, ratio.denominator)

    def is_whole(self, frames: int) -> bool:
        """Whether `frames` frames are a whole number of rows."""
        return (frames * self.num) % self.den == 0

    def rows(self, frames: int) -> int:
        """Rows in `frames` frames, rounded down where `is_whole` is false."""
        return frames * self.num // self.den

    def rows_up(self, frames: int) -> int:
        """Rows that begin within `frames` frames: rounded up."""
        return -(-frames * self.num // self.den)

    def frames(self, rows: int) -> int:
        """Frames that `rows` rows cover to their end."""
        return rows * self.den // self.num


@dataclass(frozen=True)
class Field:
    """One array that is stored for every clip.

    Attributes
    ----------
    name
        Name of the dataset in a shard: /<kind>/<name>.
    kind
        "motion" and "keymotion": clips one after another. "audio": timelines of their own, shared by clips.
    columns
        Name, width and unit of the columns, and how mirroring permutes them.
    rate
        Rows a second, exact.
    dtype
        Type on disk, little-endian.
    """

    name: str
    kind: Kind
    columns: Columns
    rate: Fraction
    dtype: Literal["float32", "float16"] = "float32"

    @property
    def per_clip(self) -> bool:
        """Whether every clip has rows of its own; else clips share timelines."""
        return self.kind != "audio"

    @property
    def disk_dtype(self) -> np.dtype[Any]:
        """The little-endian numpy dtype on disk."""
        return np.dtype(self.dtype).newbyteorder("<")

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self.columns.width * np.dtype(self.dtype).itemsize

    def row_rate(self, fps: Fraction) -> RowRate:
        """Rows of this field for each frame at `fps`."""
        return RowRate.between(self.rate, fps)

    def to_json(self) -> dict[str, Any]:
        """Return what dataset.json says of the field; the mirror is part of the columns."""
        return {
            "name": self.name,
            "kind": self.kind,
            "rate": str(self.rate),
            "dtype": self.dtype,
            "width": self.columns.width,
            "columns": self.columns.to_json(),
        }

    @classmethod
    def from_json(cls, obj: Mapping[str, Any]) -> Field:
        """Read back what `to_json` gave; raises ValueError for what it never gives."""
        known = obj["kind"] in ("motion", "keymotion", "audio") and obj["dtype"] in ("float32", "float16")
        if not known or not isinstance(obj["name"], str) or not _NAME.match(obj["name"]):
            raise ValueError(f"a field {quoted(obj['name'])}, {quoted(obj['kind'])} of {quoted(obj['dtype'])}")
        return cls(
            name=obj["name"],
            kind=obj["kind"],
            columns=Columns.from_json(obj["columns"]),
            rate=as_rate(obj["rate"]),
            dtype=obj["dtype"],
        )


@dataclass(frozen=True)
class AudioBlock:
    """A piece of audio features.

    Attributes
    ----------
    key
        What makes the rows what they are (hash of the signal and of all that shapes the feature). Blocks of
        equal key are stored once a shard.
    array
        (A, D) rows.
    offset
        Row that belongs to the clip's (window scope: the window's) frame 0.
    """

    key: str
    array: LazyArray
    offset: int = 0

    def __repr__(self) -> str:
        """Show the key's beginning and the array's shape."""
        return f"AudioBlock({self.key[:12]!r}, {' x '.join(str(n) for n in self.array.shape)}, offset={self.offset})"


@dataclass(frozen=True)
class StoredClip:
    """A clip with all that is stored of it. Arrays are loaded one at a time, when they are written.

    Attributes
    ----------
    n_frames
        Frames of the clip at the store's fps.
    starts
        First frame of every window, at the store's fps, ascending.
    motion
        Per motion and key motion field: (T, D) in track scope, (W, L, D) in window scope.
    audio
        Per audio field: one block in track scope; one a window, (L, D), in window scope.
    source
        Id of the clip that this one is a mirrored copy of, else empty.
    n_flags
        Number of quality flags raised for the clip.
    trim_start
        First frame, at the store's fps, that belongs to the dance: the source says that earlier ones should be
        cut. They are stored; readers skip them when asked to trim.
    height_m
        Vertical extent of the dancer's joints, median over frames, metres; None if unknown.
    source_rate
        Frames a second of the source, as text; empty if unknown.
    lists
        Names of the lists (such as split files) that the clip is in.
    """

    id: str
    split: str
    n_frames: int
    starts: tuple[int, ...]
    motion: Mapping[str, LazyArray]
    audio: Mapping[str, tuple[AudioBlock, ...]] = field(default_factory=dict)
    genre: str = ""
    music: str = ""
    dancer: str = ""
    tempo_bpm: float | None = None
    source: str = ""
    n_flags: int = 0
    trim_start: int = 0
    height_m: float | None = None
    source_rate: str = ""
    lists: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Show id, split and how much there is."""
        fields = ", ".join([*self.motion, *self.audio])
        return f"StoredClip({self.id!r}, {self.split}, {self.n_frames} frames, {len(self.starts)} windows, {fields})"


@dataclass(frozen=True)
class StoreHeader:
    """What holds for the whole store.

    Attributes
    ----------
    fps
        Frames a second of window starts and lengths, exact.
    length, stride
        Of the stored windows, in frames.
    order
        "time": clips by id, windows by start. "name": a plain string sort of ``<clip>_slice<k>``, as EDGE's.
    meta
        JSON that goes into dataset.json as it is (recipe, hashes, axes, licence, ...).
    """

    scope: Scope
    fps: Fraction
    length: int
    stride: int
    fields: tuple[Field, ...]
    skeleton: Skeleton
    order: Order = "time"
    meta: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    def __repr__(self) -> str:
        """Show scope, windows and fields."""
        windows = f"windows of {self.length} frames every {self.stride}"
        fields = ", ".join(f.name for f in self.fields)
        return f"StoreHeader({self.scope} scope, {self.fps} FPS, {windows}, fields: {fields})"

    def check(self) -> None:
        """Raise StoreError for values that format 1 cannot hold."""
        allowed = {"scope": ("track", "window"), "order": ("time", "name")}
        for name, values in allowed.items():
            if getattr(self, name) not in values:
                raise StoreError(f"unknown {name}", found=getattr(self, name), allowed=" or ".join(values))
        for name in ("length", "stride"):
            if getattr(self, name) < 1:
                raise StoreError(f"window {name} is no positive number of frames", found=getattr(self, name))
        names = [f.name for f in self.fields]
        if len(set(names)) != len(names):
            raise StoreError("two fields share a name", found=", ".join(names))
        if not any(f.kind == "motion" for f in self.fields):
            raise StoreError("a store needs at least one motion field", found=", ".join(names) or "no field")
        for f in self.fields:
            self._check_field(f)

    def _check_field(self, f: Field) -> None:
        check_name(f.name, "field")
        if f.kind not in ("motion", "keymotion", "audio") or f.dtype not in ("float32", "float16"):
            raise StoreError(
                f"field {f.name} has an unknown kind or dtype",
                found=f"{f.kind}, {f.dtype}",
                allowed="motion, keymotion or audio; float32 or float16",
            )
        if not f.row_rate(self.fps).is_whole(self.length):
            raise StoreError(
                f"a window is no whole number of rows of field {f.name}",
                found=f"{self.length} frames at {self.fps} a second, rows at {f.rate} a second",
                fix="choose a window length that is a multiple of both periods",
            )


@dataclass(frozen=True)
class ClipRecord:
    """A clip's row of the table /clips: all but its arrays."""

    id: str
    split: str
    genre: str
    music: str
    dancer: str
    tempo_bpm: float | None
    source: str
    n_flags: int
    trim_start: int
    height_m: float | None
    source_rate: str
    lists: tuple[str, ...]
    n_frames: int


def check_name(name: str, what: str) -> None:
    """Raise StoreError unless `name` can be part of a file name and of an HDF5 path."""
    if not _NAME.match(name):
        raise StoreError(
            f"not usable as the name of a {what}",
            found=quoted(name),
            allowed="ASCII letters, digits and _ . + -, beginning with a letter or digit",
        )


def sort_splits(splits: set[str]) -> tuple[str, ...]:
    """Sort splits into their fixed order: train, val, test, then others by name."""
    known = [s for s in SPLIT_ORDER if s in splits]
    return (*known, *sorted(splits.difference(SPLIT_ORDER)))


def shard_name(split: str, number: int, total: int) -> str:
    """Return the file name of a shard, such as train-00000-of-00004.h5."""
    return f"{split}-{number:05d}-of-{total:05d}.h5"


def is_shard_name(name: str) -> bool:
    """Tell whether `name` looks like a shard's."""
    return _SHARD.match(name) is not None


def slice_name(clip: str, index: int) -> str:
    """Return the name of a window in EDGE's files, by which order "name" sorts."""
    return f"{clip}_slice{index}"

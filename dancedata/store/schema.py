"""Format 3 of the store: file names, fields and the header. docs/reference/store.md has the layout."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import SPLIT_ORDER, check_name, is_name
from dancedata.core.codebook import Codebook, DType
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.grid import FrameGrid, as_rate
from dancedata.core.registry import beat_rows_late
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import listed, quoted

if TYPE_CHECKING:
    from dancedata.core.dance import MusicBeats

#: Version of the layout.
FORMAT = 3
#: Every dataset's bytes start at a multiple of this, so that a mapped file gives aligned arrays.
ALIGNMENT = 64
DATASET_FILE = "dataset.json"
STATS_FILE = "stats.json"
REJECTS_FILE = "rejects.jsonl"
TABLES_FILE = "tables.h5"
SEGMENTS_FILE = "segments.h5"
CARD_FILE = "README.md"
#: End of the name of a field with the motion as it was before the recipe's repairs.
ORIGINAL = ".original"
#: Where the source lies on this machine: no part of the dataset, so neither hashed, nor pushed or exported.
LOCAL_FILE = "local.json"
#: What a publication has in addition, and in the place of dataset.json where it has a recipe and no data.
PUBLICATION_FILE = "publication.json"
SIDE_FILES = (STATS_FILE, REJECTS_FILE, CARD_FILE)

_SHARD = re.compile(r"(.+-\d{5,}-of-\d{5,}|tables|segments)\.h5\Z")

Kind = Literal["motion", "keymotion", "audio"]
_KINDS = ("motion", "keymotion", "audio")
#: The column of beats without the others.
_BEAT_ALONE = Columns((Group("beat", 1, "0/1"),), None)
_DTYPES = {"real": ("float32", "float16"), "code": ("int16", "int32", "uint8")}


@dataclass(frozen=True)
class Field:
    """One array that is stored for every clip.

    Attributes
    ----------
    name
        Name of the dataset in a shard: /<kind>/<name>.
    kind
        "motion" and "keymotion": clips one after another. "audio": timelines that clips share.
    columns
        Name, width and unit of the columns, and how mirroring permutes them.
    rate
        Rows per second, exact.
    dtype
        Type on disk, little-endian; whole numbers for codes.
    codebook
        Of codes; None for real values.
    optional
        Whether clips may have no rows of it, see `Tables.has_rows`; of motion and key motions alone.
    axes
        Handedness, up axis and unit of motion, in words.
    """

    name: str
    kind: Kind
    columns: Columns
    rate: Fraction
    dtype: DType = "float32"
    codebook: Codebook | None = None
    optional: bool = False
    axes: str = ""

    @property
    def per_clip(self) -> bool:
        """Whether every clip has its own rows; otherwise clips share timelines."""
        return self.kind in ("motion", "keymotion")

    @property
    def path(self) -> str:
        """Name of the dataset in a shard: "motion/edge151"."""
        return f"{self.kind}/{self.name}"

    @property
    def span_columns(self) -> tuple[str, ...]:
        """Names of the columns /clips/<kind>/<name>/... with the rows of each clip."""
        return ("start", "length") if self.per_clip else ("start", "length", "offset")

    @property
    def disk_dtype(self) -> np.dtype[Any]:
        """The little-endian numpy dtype on disk."""
        return np.dtype(self.dtype).newbyteorder("<")

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self.columns.width * np.dtype(self.dtype).itemsize

    def beats(self, rows: npt.NDArray[Any]) -> MusicBeats:
        """Return the beats of rows (T, D) of the field, or of its column of beats alone (T,), at their instants."""
        from dancedata.core.dance import MusicBeats

        late = beat_rows_late(self.name)
        if rows.ndim == 1:
            return MusicBeats.of_rows(rows[:, None], _BEAT_ALONE, self.grid, late=late)
        return MusicBeats.of_rows(rows, self.columns, self.grid, late=late)

    @cached_property
    def grid(self) -> FrameGrid:
        """The grid of the rows."""
        return FrameGrid(self.rate)

    def to_json(self) -> dict[str, Any]:
        """Return the field's entry in dataset.json; the mirror is part of the columns."""
        return {
            "name": self.name,
            "kind": self.kind,
            "rate": str(self.rate),
            "dtype": self.dtype,
            "columns": self.columns.to_json(),
            **({} if self.codebook is None else {"codebook": self.codebook.to_json()}),
            **({"optional": True} if self.optional else {}),
            **({"axes": self.axes} if self.axes else {}),
        }

    @classmethod
    def from_json(cls, obj: Mapping[str, Any]) -> Field:
        """Read an entry that `to_json` gave; ValueError for anything else."""
        values = "code" if "codebook" in obj else "real"
        is_supported = obj["kind"] in _KINDS and obj["dtype"] in _DTYPES[values]
        if not is_supported or not is_name(obj["name"]):
            raise ValueError(f"a field {quoted(obj['name'])}, {quoted(obj['kind'])} of {quoted(obj['dtype'])}")
        columns = Columns.from_json(obj["columns"])
        return cls(
            name=obj["name"],
            kind=obj["kind"],
            columns=columns,
            rate=as_rate(obj["rate"]),
            dtype=obj["dtype"],
            codebook=_codebook(obj["codebook"], columns.width, obj["dtype"]) if values == "code" else None,
            optional=obj.get("optional") is True,
            axes=str(obj.get("axes", "")),
        )


def _codebook(obj: Mapping[str, Any], width: int, dtype: str) -> Codebook:
    sizes = tuple(int(size) for size in obj["sizes"])
    codebook = Codebook(str(obj["name"]), sizes, str(obj["sha256"]), int(obj["pad"]))
    try:
        codebook.check(width, dtype)
    except UsageError as error:
        raise ValueError(str(error)) from error
    return codebook


@dataclass(frozen=True)
class StoreHeader:
    """Properties of the whole store.

    Attributes
    ----------
    fps
        Frames per second of window starts and lengths, exact.
    length, stride
        Of the stored windows, in frames.
    meta
        JSON that is copied into dataset.json (recipe, hashes, axes, licence, ...).
    """

    fps: Fraction
    length: int
    stride: int
    fields: tuple[Field, ...]
    skeleton: Skeleton
    meta: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @cached_property
    def grid(self) -> FrameGrid:
        """The grid of the store's frames."""
        return FrameGrid(self.fps)

    def check(self) -> None:
        """Raise StoreError for values that the format cannot hold."""
        for name in ("length", "stride"):
            if getattr(self, name) < 1:
                raise StoreError(f"window {name} is not a positive number of frames", found=getattr(self, name))
        names = [f.name for f in self.fields]
        if len(set(names)) != len(names):
            raise StoreError("two fields share a name", found=", ".join(names))
        if not any(f.kind == "motion" for f in self.fields):
            raise StoreError("a store needs at least one motion field", found=", ".join(names) or "no field")
        if all(f.optional for f in self.fields if f.kind == "motion"):
            raise StoreError("every motion field is optional", fix="one has to be there for every clip")
        for f in self.fields:
            self._check_field(f)

    def _check_field(self, f: Field) -> None:
        check_name(f.name, "field")
        dtypes = _DTYPES["real" if f.codebook is None else "code"]
        if f.kind not in _KINDS or f.dtype not in dtypes:
            raise StoreError(f"field {f.name} has an unknown kind or dtype", found=f"{f.kind}, {f.dtype}",
                             allowed=f"{listed(_KINDS)}; {listed(dtypes)}")  # fmt: skip
        if f.codebook is not None:
            try:
                f.codebook.check(f.columns.width, f.dtype)
            except UsageError as error:
                raise StoreError(f"the codebook of field {f.name} cannot be stored", found=str(error)) from error
        if f.optional and not f.per_clip:
            raise StoreError(f"field {f.name} cannot be optional", allowed="fields of motion and key motions")
        if not self.grid.is_whole(self.length, of=f.grid):
            raise StoreError(f"a window is not a whole number of rows of field {f.name}",
                             found=f"{self.length} frames at {self.fps} per second, rows at {f.rate} per second",
                             fix="choose a window length that is a multiple of both periods")  # fmt: skip


def sort_splits(splits: set[str]) -> tuple[str, ...]:
    """Sort splits into their fixed order: train, val, test, then others by name."""
    standard = [s for s in SPLIT_ORDER if s in splits]
    return (*standard, *sorted(splits.difference(SPLIT_ORDER)))


def shard_name(split: str, number: int, total: int) -> str:
    """Return the file name of a shard, such as train-00000-of-00004.h5."""
    return f"{split}-{number:05d}-of-{total:05d}.h5"


def is_shard_name(name: str) -> bool:
    """Whether `name` is that of a shard, or of the tables or segments."""
    return _SHARD.match(name) is not None

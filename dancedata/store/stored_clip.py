"""Clips with their arrays, as input of the writer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.core.licence import Licence
from dancedata.core.segments import Segment
from dancedata.core.text import quoted, shown
from dancedata.store.clip_columns import CLIP_COLUMNS, ClipRecord
from dancedata.store.schema import Field, StoreHeader


@runtime_checkable
class LazyArray(Protocol):
    """Anything with a shape that numpy can turn into an array: an ndarray, or a file opened on demand."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array, known without loading it."""
        ...

    def __array__(self) -> npt.NDArray[Any]: ...


@dataclass(frozen=True)
class AudioBlock:
    """Rows that are computed of music, which clips share.

    Attributes
    ----------
    key
        Identity of the rows: a hash of the signal and of everything that shapes the feature. Blocks of equal key
        are stored once per shard.
    array
        (A, D) rows.
    offset
        Row at frame 0 of the clip, negative where the rows begin later.
    """

    key: str
    array: LazyArray
    offset: int = 0


class Signal(NamedTuple):
    """A decoded song: SHA-256 of its samples, and whole numbers of its sound; () if those were not computed."""

    sha256: str
    sample_rate: int
    n_samples: int
    fingerprint: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StoredClip(ClipRecord):
    """A clip to store: its record and its arrays, which are loaded one at a time, when they are written.

    Attributes
    ----------
    starts
        First frame of every window, at the store's fps, ascending multiples of the stride.
    motion
        Per motion and key motion field: (T, D); (0, D) of an optional field that the clip does not have.
    audio
        Per audio field: the rows of its music.
    signal
        The decoded music, for the table of songs; None if it is not recorded. Clips with one `song` have one.
    segments
        Spans and instants of the clip.
    group_size
        Dancers that the group has in the source, stored or not; 0: as many as are stored.
    terms
        Licence and citation of this clip; None for those of the dataset.
    """

    starts: tuple[int, ...]
    motion: Mapping[str, LazyArray]
    audio: Mapping[str, AudioBlock] = field(default_factory=dict)
    signal: Signal | None = None
    segments: tuple[Segment, ...] = ()
    group_size: int = 0
    terms: Licence | None = None


def check_clip(header: StoreHeader, clip: StoredClip) -> None:
    """Raise StoreError, naming clip and field, for a clip that does not fit the header. Loads no array."""
    _check_attributes(clip)
    _check_windows(header, clip)
    motion = [f for f in header.fields if f.per_clip]
    audio = [f for f in header.fields if not f.per_clip]
    _check_names(clip, "motion", motion, clip.motion)
    _check_names(clip, "audio", audio, clip.audio)
    for f in motion:
        _check_motion(header, clip, f, clip.motion[f.name])
    for f in audio:
        _check_audio(header, clip, f, clip.audio[f.name])
    if off := [start for start in clip.starts if start % header.stride]:
        raise StoreError("a window does not begin at a multiple of the stride", where=f"clip {clip.id}",
                         found=f"frame {off[0]}", allowed=f"every {header.stride} frames from 0 on")  # fmt: skip


def _check_attributes(clip: StoredClip) -> None:
    for column in CLIP_COLUMNS:
        value = getattr(clip, column.name)
        problem = column.problem(value)
        if problem:
            where = f"clip {quoted(clip.id)} of split {shown(clip.split)}, {column.name}"
            raise StoreError(f"an attribute of a clip cannot be stored: {problem}", where=where, found=quoted(value))


def _check_windows(header: StoreHeader, clip: StoredClip) -> None:
    starts = clip.starts
    if any(b <= a for a, b in pairwise(starts)) or (starts and starts[0] < 0):
        raise StoreError("window starts are not ascending from 0 on", where=f"clip {clip.id}", found=str(starts[:20]))
    if starts and starts[-1] + header.length > clip.n_frames:
        raise StoreError("a window ends after its clip", where=f"clip {clip.id}, window {len(starts) - 1}",
                         found=f"frames {starts[-1]} to {starts[-1] + header.length} of {clip.n_frames}")  # fmt: skip


def _check_names(clip: StoredClip, kind: str, fields: list[Field], present: Iterable[str]) -> None:
    needed, present_names = {f.name for f in fields}, set(present)
    if needed != present_names:
        raise StoreError(f"a clip's {kind} fields are not those of the store", where=f"clip {clip.id}",
                         found=", ".join(sorted(present_names)) or "none",
                         allowed=", ".join(sorted(needed)) or "none")  # fmt: skip


def _check_motion(header: StoreHeader, clip: StoredClip, f: Field, array: LazyArray) -> None:
    where = f"clip {clip.id}, field {f.name}"
    shape = tuple(array.shape)
    _check_columns(where, shape, f)
    if f.optional and shape[0] == 0:
        return
    # A clip at another rate ends within the last frame: less than one frame, or one row, of difference.
    frames, rows = header.grid.common_period(f.grid)
    if abs(shape[0] * frames - clip.n_frames * rows) >= max(frames, rows):
        raise StoreError(
            "rows and frames do not match",
            where=where,
            found=f"{shape[0]} rows at {f.rate} per second for {clip.n_frames} frames at {header.fps} per second",
        )
    _check_end(header, clip, f, shape[0], where)


def _check_audio(header: StoreHeader, clip: StoredClip, f: Field, block: AudioBlock) -> None:
    where = f"clip {clip.id}, field {f.name}"
    shape, offset = tuple(block.array.shape), block.offset
    _check_columns(where, shape, f)
    _check_end(header, clip, f, shape[0] - offset, where)
    if clip.starts and header.grid.rows_down(clip.starts[0], of=f.grid) + offset < 0:
        raise StoreError("a window begins before its music", where=f"{where}, window 0",
                         found=f"frame {clip.starts[0]}",
                         allowed=f"from frame {f.grid.rows_up(-offset, of=header.grid)} on")  # fmt: skip


def _check_columns(where: str, shape: tuple[int, ...], f: Field) -> None:
    if len(shape) != 2 or shape[1] != f.columns.width:
        raise StoreError("wrong shape", where=where, found=shape, allowed=f"(rows, {f.columns.width})")


def _check_end(header: StoreHeader, clip: StoredClip, f: Field, available: int, where: str) -> None:
    for k, start in enumerate(clip.starts):
        if not header.grid.is_whole(start, of=f.grid):
            raise StoreError("a window begins between two rows", where=f"{where}, window {k}",
                             found=f"frame {start} at {header.fps} per second, rows at {f.rate} per second",
                             fix="choose a stride that is a multiple of both periods")  # fmt: skip
    end = header.grid.rows(clip.starts[-1] + header.length, of=f.grid) if clip.starts else 0
    if end > available:
        raise StoreError("a window ends after the last row", where=f"{where}, window {len(clip.starts) - 1}",
                         found=f"row {end} of {available}")  # fmt: skip

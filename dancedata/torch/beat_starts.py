"""Windows that begin on a beat or a downbeat, and the tempo of stored beats."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dancedata.core.clip import Reject
from dancedata.core.errors import UsageError
from dancedata.core.registry import beat_rows_late
from dancedata.store.dataset import Store
from dancedata.store.schema import Field
from dancedata.store.window_list import IntArray, WindowList
from dancedata.torch.music_beats import StartAt, preferred


def windows_at(
    store: Store, windows: WindowList, spacing: Mapping[str, Any], *, at: StartAt, fields: Sequence[str], trim: bool
) -> tuple[WindowList, tuple[Reject, ...]]:
    """Return windows that begin at beats, starts at least a stride apart, and a reject for each clip without one."""
    grid = store._window_grid(**spacing)
    rejects: list[Reject] = []
    clip: list[int] = []
    start: list[int] = []
    for place in np.unique(windows.clip).tolist():
        candidates = beat_starts(store, windows.clip_ids[place], grid.length, at=at, fields=fields, trim=trim)
        spaced = _apart(candidates, grid.stride)
        if not spaced:
            rejects.append(no_start(windows.clip_ids[place], grid.length, at))
        clip += [place] * len(spaced)
        start += spaced
    clips, starts = (np.asarray(values, dtype=np.int64) for values in (clip, start))
    return WindowList.equally_long(windows.split, windows.clip_ids, clips, starts, grid.length), tuple(rejects)


def beat_starts(store: Store, clip: str, length: int, *, at: StartAt, fields: Sequence[str], trim: bool) -> IntArray:
    """Return the frames (N,) of a clip at which a window can begin on a beat, of the first field that has beats."""
    beats = _field_with(store, at, fields)
    starts = store._starts(clip, length, fields=tuple(fields), trim=trim)
    if not len(starts):
        return np.empty(0, dtype=np.int64)
    first, labelled = store[clip].rows_within(beats.name)
    rows = first + np.flatnonzero(labelled[:, beats.columns.slice(at).start])
    rows = np.maximum(rows.astype(np.int64) - beat_rows_late(beats.name), 0)
    frames = beats.grid.nearest_rows(rows, of=store.grid)
    nearest = starts.start + (frames - starts.start + starts.step // 2) // starts.step * starts.step
    first_frames: IntArray = np.unique(nearest[(nearest >= starts.start) & (nearest < starts.stop)])
    return first_frames


def estimated_tempo(store: Store, clip: str, fields: Sequence[str]) -> float:
    """Return the tempo of a clip's stored beats, beats per minute: 60 / the mean time from one to the next.

    Times that differ from the median by more than a quarter, where a beat was missed, do not count. The beats are
    those that `beat_starts` takes; nan without two that follow each other.
    """
    if not store.fields_with("beat"):
        return math.nan
    beats = _field_with(store, "beat", fields)
    column = beats.columns.slice("beat").start
    rows = np.diff(np.flatnonzero(store[clip].rows_within(beats.name)[1][:, column]))
    near = rows[np.abs(rows - np.median(rows)) <= np.median(rows) / 4] if len(rows) else rows
    return 60.0 / (float(beats.grid.seconds(1)) * float(near.mean())) if len(near) else math.nan


def no_start(clip: str, length: int, at: StartAt) -> Reject:
    """Return the reject of a clip in which no window can begin on a beat."""
    return Reject("filtered", clip, detail=f"no {at} at which a window of {length} frames could begin")


def _field_with(store: Store, group: str, fields: Sequence[str]) -> Field:
    for field in preferred(store.fields_with(group), fields):
        return field
    raise UsageError(f"no field of the dataset has the column {group}", where=str(store.path),
                     found=f"fields {', '.join(store.fields)}",
                     fix="build with audio: {beats: {source: beat_this}}")  # fmt: skip


def _apart(starts: IntArray, stride: int) -> list[int]:
    """Return those of ascending starts that are at least `stride` after the one kept before."""
    spaced: list[int] = []
    for start in starts.tolist():
        if not spaced or start >= spaced[-1] + stride:
            spaced.append(start)
    return spaced

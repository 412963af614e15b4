"""Checks whether a clip given to the writer can be stored: names, shapes, rows for every window."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

from dancedata.core.errors import StoreError
from dancedata.core.text import is_unicode, quoted
from dancedata.store.schema import LIST_SEPARATOR, AudioBlock, Field, LazyArray, StoredClip, StoreHeader


def check_clip(header: StoreHeader, clip: StoredClip) -> None:
    """Raise StoreError, naming clip and field, for a clip that does not fit the header. Loads no array."""
    _check_texts(clip)
    _check_windows(header, clip)
    motion = [f for f in header.fields if f.per_clip]
    audio = [f for f in header.fields if f.kind == "audio"]
    _check_names(clip, "motion", motion, clip.motion)
    _check_names(clip, "audio", audio, clip.audio)
    for f in motion:
        _check_motion(header, clip, f, clip.motion[f.name])
    for f in audio:
        _check_audio(header, clip, f, clip.audio[f.name])


def _check_texts(clip: StoredClip) -> None:
    if not clip.id:
        raise StoreError("a clip has no id", where=f"split {clip.split}")
    for text in (clip.id, clip.genre, clip.music, clip.dancer, clip.source, clip.source_rate, *clip.lists):
        # Fixed-length strings are padded with NUL, and lists are joined by line breaks.
        if "\0" in text or LIST_SEPARATOR in text or not is_unicode(text):
            problem = "a text has a NUL or a line break in it, or is not valid Unicode"
            raise StoreError(problem, where=f"clip {quoted(clip.id)}", found=quoted(text))
    if "" in clip.lists:
        raise StoreError("a list has no name", where=f"clip {clip.id}", found=clip.lists)


def _check_windows(header: StoreHeader, clip: StoredClip) -> None:
    starts = clip.starts
    if clip.n_frames < 1:
        raise StoreError("a clip has no frames", where=f"clip {clip.id}", found=clip.n_frames)
    if any(b <= a for a, b in pairwise(starts)) or (starts and starts[0] < 0):
        raise StoreError("window starts are not ascending from 0 on", where=f"clip {clip.id}", found=str(starts[:20]))
    if starts and starts[-1] + header.length > clip.n_frames:
        raise StoreError(
            "a window ends after its clip",
            where=f"clip {clip.id}, window {len(starts) - 1}",
            found=f"frames {starts[-1]} to {starts[-1] + header.length} of {clip.n_frames}",
        )


def _check_names(clip: StoredClip, kind: str, fields: list[Field], given: Iterable[str]) -> None:
    wanted, found = {f.name for f in fields}, set(given)
    if wanted != found:
        raise StoreError(
            f"a clip's {kind} fields are not those of the store",
            where=f"clip {clip.id}",
            found=", ".join(sorted(found)) or "none",
            allowed=", ".join(sorted(wanted)) or "none",
        )


def _check_motion(header: StoreHeader, clip: StoredClip, f: Field, array: LazyArray) -> None:
    where = f"clip {clip.id}, field {f.name}"
    rate = f.row_rate(header.fps)
    shape = tuple(array.shape)
    if header.scope == "window":
        wanted = (len(clip.starts), rate.rows(header.length), f.columns.width)
        if shape != wanted:
            raise StoreError("wrong shape", where=where, found=shape, allowed=f"{wanted} (windows, rows, columns)")
        return
    _check_rows(where, shape, f)
    # A clip at another rate ends within the last frame: less than one frame, or one row, of difference.
    if abs(shape[0] * rate.den - clip.n_frames * rate.num) >= max(rate.num, rate.den):
        raise StoreError(
            "rows and frames do not match",
            where=where,
            found=f"{shape[0]} rows at {f.rate} a second for {clip.n_frames} frames at {header.fps} a second",
        )
    _check_end(header, clip, f, shape[0], where)


def _check_audio(header: StoreHeader, clip: StoredClip, f: Field, blocks: tuple[AudioBlock, ...]) -> None:
    where = f"clip {clip.id}, field {f.name}"
    wanted = 1 if header.scope == "track" else len(clip.starts)
    if len(blocks) != wanted:
        each = "one a clip in track scope" if header.scope == "track" else "one a window in window scope"
        raise StoreError("wrong number of audio blocks", where=where, found=len(blocks), allowed=f"{wanted}: {each}")
    rows = f.row_rate(header.fps).rows(header.length)
    for block in blocks:
        shape = tuple(block.array.shape)
        _check_rows(where, shape, f)
        if block.offset < 0:
            raise StoreError("an audio offset is negative", where=where, found=block.offset)
        if header.scope == "window" and block.offset + rows > shape[0]:
            raise StoreError(
                "an audio block is shorter than a window",
                where=where,
                found=shape[0],
                allowed=block.offset + rows,
            )
    if header.scope == "track":
        _check_end(header, clip, f, blocks[0].array.shape[0] - blocks[0].offset, where)


def _check_rows(where: str, shape: tuple[int, ...], f: Field) -> None:
    if len(shape) != 2 or shape[1] != f.columns.width:
        raise StoreError("wrong shape", where=where, found=shape, allowed=f"(rows, {f.columns.width})")


def _check_end(header: StoreHeader, clip: StoredClip, f: Field, available: int, where: str) -> None:
    """Check that every window begins at a whole row and ends within the rows that there are."""
    rate = f.row_rate(header.fps)
    for k, start in enumerate(clip.starts):
        if not rate.is_whole(start):
            raise StoreError(
                "a window begins between two rows",
                where=f"{where}, window {k}",
                found=f"frame {start} at {header.fps} a second, rows at {f.rate} a second",
                fix="choose a stride that is a multiple of both periods",
            )
    if clip.starts and rate.rows(clip.starts[-1] + header.length) > available:
        raise StoreError(
            "a window ends after the last row",
            where=f"{where}, window {len(clip.starts) - 1}",
            found=f"row {rate.rows(clip.starts[-1] + header.length)} of {available}",
        )

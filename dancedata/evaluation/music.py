"""Where the beats of the music of clips are from: given, a store's column, or music files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dancedata.core.errors import UsageError
from dancedata.core.text import listed
from dancedata.datasets.aistpp.facts import parse_name, tempo_bpm
from dancedata.evaluation.clip_music import BEAT, ClipMusic
from dancedata.evaluation.inputs.clip import ClipInput
from dancedata.evaluation.inputs.store import StoreClip
from dancedata.evaluation.protocol import MusicRule, Pieces
from dancedata.store import Store

__all__ = ["beat_field", "named_songs", "read_songs", "stored_beats"]

_MAX_CSV_BYTES = 1 << 24


def stored_beats(store: Store, rule: MusicRule, pieces: Pieces, clips: Sequence[ClipInput]) -> dict[str, ClipMusic]:
    """Return the beats that a store has for clips, by their ids; empty if it has no field of the protocol.

    A clip takes its own rows or, if it is not in the store, those of the longest clip with the same music.
    """
    name = beat_field(store, rule, pieces)
    if name is None:
        return {}
    column, grid = store.fields[name].slice(BEAT).start, store.field(name).grid
    records = {c.id: c for c in store.clips if not c.source}
    longest = {c.music: c.id for c in sorted(records.values(), key=lambda c: (c.n_frames, c.id)) if c.music}
    found = {}
    for clip in clips:
        if isinstance(clip, StoreClip) and clip.window is not None and clip.reference == store.reference:
            found[clip.id] = ClipMusic.of_rows(store.read(clip.window, name), column, grid)
            continue
        source = clip.id if clip.id in records else longest.get(clip.music)
        if source is not None and store.scope == "track":
            found[clip.id] = ClipMusic.of_rows(store.read_clip(source, name), column, grid)
    return found


def beat_field(store: Store, rule: MusicRule, pieces: Pieces) -> str | None:
    """Return the audio field of a store that has the protocol's beats."""
    if store.scope == "window" and store.meta["windows"]["length"] != pieces.frames(store.grid)[0]:
        return None
    if rule.scope == "window" and store.scope != "window":
        return None
    for feature in rule.features:
        for name, columns in store.fields.items():
            own_rate = rule.grid in (None, store.field(name).grid)
            if name.split(".")[0] == feature and BEAT in columns.names and own_rate:
                return name
    return None


def read_songs(path: Path) -> dict[str, str]:
    """Read clip and song from a CSV file with these two columns; a heading "clip,song" may come first.

    Raises
    ------
    UsageError
        If it cannot be read, or a line has another number of columns.
    """
    try:
        if path.stat().st_size > _MAX_CSV_BYTES:
            raise UsageError("the list of songs is too large", where=path, allowed=f"{_MAX_CSV_BYTES:,} bytes")
        lines = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError("the list of songs cannot be read", where=path, found=str(error)) from error
    songs = {}
    for number, line in enumerate(lines, start=1):
        if not line or (number == 1 and [cell.strip().lower() for cell in line] == ["clip", "song"]):
            continue
        if len(line) != 2:
            raise UsageError(
                "a line does not have two columns",
                where=f"{path}, line {number}",
                found=len(line),
                allowed="clip,song",
            )
        songs[line[0].strip()] = Path(line[1].strip()).stem
    return songs


def named_songs(clips: Sequence[ClipInput], songs: Mapping[str, str], like: Store | None) -> tuple[ClipInput, ...]:
    """Return clips with the names and tempos of their songs.

    The name is from the list, the clip itself, the clip of that id in a store, or AIST++'s name of a sequence;
    else it is the clip's id.
    """
    records = {} if like is None else {c.id: c for c in like.clips}
    unknown = sorted(set(songs) - {clip.id for clip in clips})
    if unknown:
        raise UsageError("the list of songs names clips that are not there", found=listed(unknown))
    named = []
    for clip in clips:
        record, name = records.get(clip.id), parse_name(clip.id)
        known = (songs.get(clip.id), clip.music, record and record.music, name and name.music, clip.id)
        music = next(text for text in known if text)
        tempo = clip.tempo_bpm or (record.tempo_bpm if record else None) or tempo_bpm(music)
        named.append(replace(clip, music=music, tempo_bpm=tempo))
    return tuple(named)

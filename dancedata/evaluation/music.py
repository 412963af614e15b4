"""Where the beats of the music of clips are from: given, a store's column, or music files."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dancedata.core.clip import Window
from dancedata.core.errors import UsageError
from dancedata.core.text import csv_text, listed, quoted
from dancedata.datasets.aistpp import parse_name, tempo_bpm
from dancedata.datasets.files import AUDIO_SUFFIXES
from dancedata.evaluation.clip_music import BEAT, ClipMusic
from dancedata.evaluation.inputs.clip import ClipInput
from dancedata.evaluation.inputs.store import StoreClip
from dancedata.evaluation.protocol import MusicRule, Pieces
from dancedata.store import Store
from dancedata.store.listed_file import FileHash

__all__ = ["about_windows", "beat_field", "named_songs", "read_songs", "song_name", "stored_beats"]

_MAX_CSV_BYTES = 1 << 24


def stored_beats(
    store: Store,
    rule: MusicRule,
    pieces: Pieces,
    clips: Sequence[ClipInput],
    songs: Mapping[str, str],
    sha256: FileHash,
) -> dict[str, ClipMusic]:
    """Return the beats that a store has for clips, by their ids; empty if it has no field of the protocol.

    A clip takes its own rows or, if it is not in the store or `songs` names another song for it, those of the longest
    clip with that song. StoreError if their shards have other bytes than the build wrote, by `sha256` of files.
    """
    name = beat_field(store, rule, pieces)
    if name is None:
        return {}
    field = store.field(name)
    records = {c.id: c for c in store.clips if not c.source}
    longest = {c.music: c.id for c in sorted(records.values(), key=lambda c: (c.n_frames, c.id)) if c.music}
    sources: dict[str, str | Window] = {}
    for clip in clips:
        record = records.get(clip.clip)
        own = record is not None and songs.get(clip.id) in (None, record.music)
        if own and isinstance(clip, StoreClip) and clip.window is not None and clip.reference == store.reference:
            sources[clip.id] = clip.window
            continue
        source = clip.clip if own else longest.get(clip.music)
        if source is not None and store.scope == "track":
            sources[clip.id] = source
    store.require_intact({s.clip if isinstance(s, Window) else s for s in sources.values()}, sha256=sha256)
    read = {c: store.read(s, name) if isinstance(s, Window) else store.read_clip(s, name) for c, s in sources.items()}
    return {clip: ClipMusic.of_rows(rows, field) for clip, rows in read.items()}


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


def about_windows(store: Store, rule: MusicRule) -> list[str]:
    """Warn of a store that has beats of each window alone, where a protocol takes those of whole songs."""
    if store.scope == "track" or rule.scope == "window":
        return []
    return [
        "beats are those of each window by itself, as the dataset is of window scope; the protocol takes those of "
        "whole songs: scores of beats compare with those of such datasets alone"
    ]


def song_name(text: str) -> str:
    """Return the name of a song: that of a music file without folder and suffix, any other text as it is."""
    path = Path(text.strip())
    return path.stem if path.suffix.lower() in AUDIO_SUFFIXES else path.name


def read_songs(path: Path) -> dict[str, str]:
    """Read clip and song from a CSV file with these two columns; a heading "clip,song" may come first.

    Columns are separated by commas, semicolons or tabulators, whichever make two of the first line.

    Raises
    ------
    UsageError
        If it cannot be read, a line has another number of columns or no song, or two lines have one clip.
    """
    try:
        if path.stat().st_size > _MAX_CSV_BYTES:
            raise UsageError("the list of songs is too large", where=path, allowed=f"{_MAX_CSV_BYTES:,} bytes")
        text = path.read_bytes().decode("utf-8-sig")
        head = text.lstrip().partition("\n")[0]
        between = next((c for c in ",;\t" if len(next(csv.reader([head], delimiter=c), [])) == 2), ",")
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=between))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError("the list of songs cannot be read", where=path, found=str(error)) from error
    songs: dict[str, str] = {}
    for number, line in enumerate(lines, start=1):
        if not line or (number == 1 and [cell.strip().lower() for cell in line] == ["clip", "song"]):
            continue
        where = f"{path}, line {number}"
        if len(line) != 2:
            raise UsageError("a line does not have two columns", where=where, found=len(line), allowed="clip,song")
        clip, song = csv_text(line[0].strip()), song_name(csv_text(line[1].strip()))
        if not song:
            raise UsageError("a line without a song", where=where, found=quoted(line[1]), allowed="clip,song")
        if songs.setdefault(clip, song) != song:
            raise UsageError("a clip has two songs", where=where, found=listed([songs[clip], song]), fix="delete one")
    return songs


def named_songs(clips: Sequence[ClipInput], songs: Mapping[str, str], like: Store | None) -> tuple[ClipInput, ...]:
    """Return clips with the names and tempos of their songs.

    The name is from the list, the clip itself, the clip of that id in a store, or AIST++'s name of a sequence;
    else it is the clip's id. The tempo is that of this song, where the clip, a clip of the store or AIST++'s name
    states it.
    """
    records = {} if like is None else {c.id: c for c in like.clips}
    tempos = {c.music: c.tempo_bpm for c in records.values() if c.music and c.tempo_bpm}
    unknown = sorted(set(songs) - {clip.id for clip in clips})
    if unknown:
        raise UsageError("the list of songs names clips that are not there", found=listed(unknown))
    named = []
    for clip in clips:
        record, name, given = records.get(clip.id), parse_name(clip.id), songs.get(clip.id)
        known = (given, clip.music, record and record.music, name and name.music, clip.id)
        music = next(text for text in known if text)
        same = [c for c in (clip, record) if c is not None and given in (None, c.music)]
        tempo = next((c.tempo_bpm for c in same if c.tempo_bpm), None) or tempos.get(music) or tempo_bpm(music)
        named.append(replace(clip, music=music, tempo_bpm=tempo))
    return tuple(named)

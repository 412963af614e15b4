"""Beats of the music of clips: of the caller, of music files, or of a dataset; names of songs."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from dancedata.core.clip import Window
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError
from dancedata.core.text import csv_text, listed, quoted
from dancedata.datasets.aistpp import parse_name, tempo_bpm
from dancedata.datasets.files import AUDIO_SUFFIXES
from dancedata.evaluation.clip_music import BEAT, ClipMusic
from dancedata.evaluation.inputs.clip import ClipInput, ClipSet
from dancedata.evaluation.inputs.store import StoreClip
from dancedata.evaluation.measuring import Resources
from dancedata.evaluation.protocol import MusicRule, Pieces, Protocol
from dancedata.evaluation.song_beats import song_beats
from dancedata.store import Store
from dancedata.store.listed_file import FileHash

_MAX_CSV_BYTES = 1 << 24


@dataclass(frozen=True, eq=False)
class MusicSources:
    """Sources of beats; for each clip the first one that has them counts.

    Attributes
    ----------
    beats
        Beats of the caller, by the id of a clip.
    files
        Music files, by song.
    stores
        Datasets.
    songs
        Songs that the caller names, by the id of a clip.
    """

    beats: Mapping[str, MusicBeats] = field(default_factory=dict)
    files: Mapping[str, Path] = field(default_factory=dict)
    stores: tuple[Store, ...] = ()
    songs: Mapping[str, str] = field(default_factory=dict)


def clip_music(
    resources: Resources, protocol: Protocol, clip_set: ClipSet, sources: MusicSources
) -> tuple[dict[str, ClipMusic], list[str]]:
    """Return beats by the id of a clip, and problems in words."""
    rule, role = protocol.music, clip_set.role
    if rule is None:
        return {}, []
    music = {clip: ClipMusic(beats) for clip, beats in sources.beats.items()}
    problems: list[str] = []
    if sources.files:
        without = [clip for clip in clip_set.clips if clip.id not in music]
        computed, problems = song_beats(resources, protocol, rule, role, without, sources.files)
        music |= computed
    for store in sources.stores:
        without = [clip for clip in clip_set.clips if clip.id not in music]
        if without:
            stored = stored_beats(
                store, rule, protocol.pieces(role), without, sources.songs, resources.cache.file_sha256
            )
            problems += about_windows(store, rule) if stored else []
            music |= stored
    silent = sorted({clip.music for clip in clip_set.clips if clip.id in sources.songs and clip.id not in music})
    if silent and not sources.files:
        problems.append(f"no beats of songs that --music-of names: {listed(silent)}")
    if not music:
        problems.append(_no_music(rule))
    return music, problems


def _no_music(rule: MusicRule) -> str:
    rate = f" at {rule.fps} per second" if rule.fps else ""
    scope = ", each piece by itself" if rule.scope == "window" else ""
    about = f" ({rule.about})" if rule.about else ""
    return (
        f"no beats of music: the protocol takes those of {' or '.join(rule.features)}{rate}{scope}{about}; give "
        "--source MUSIC or a dataset with that field (--like), and --music-of FILE.csv for clips whose ids are not "
        "those of songs or of clips of the dataset"
    )


def stored_beats(
    store: Store,
    rule: MusicRule,
    pieces: Pieces,
    clips: Sequence[ClipInput],
    songs: Mapping[str, str],
    sha256: FileHash,
) -> dict[str, ClipMusic]:
    """Return the beats that a store has for clips, by their ids; empty if it has no field of the protocol.

    They are of the clip's rows or, if it is not in the store or `songs` names another song for it, of the longest
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
        same_song = record is not None and songs.get(clip.id) in (None, record.music)
        if same_song and isinstance(clip, StoreClip) and clip.window and clip.reference == store.reference:
            sources[clip.id] = clip.window
            continue
        source = clip.clip if same_song else longest.get(clip.music)
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
            same_rate = rule.grid in (None, store.field(name).grid)
            if name.split(".")[0] == feature and BEAT in columns.names and same_rate:
                return name
    return None


def about_windows(store: Store, rule: MusicRule) -> list[str]:
    """Return a warning if a store has beats of each window alone, and a protocol takes those of whole songs."""
    if store.scope == "track" or rule.scope == "window":
        return []
    return [
        "beats are those of each window by itself, as the dataset is of window scope; the protocol takes those of "
        "whole songs: scores of beats only compare with those of such datasets"
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

    The name is from `songs`, the clip itself, the clip of that id in a store, or AIST++'s name of a sequence;
    otherwise it is the clip's id. The tempo is of this song, where the clip, a clip of the store or AIST++ states it.
    """
    records = {} if like is None else {c.id: c for c in like.clips}
    tempos = {c.music: c.tempo_bpm for c in records.values() if c.music and c.tempo_bpm}
    unknown = sorted(set(songs) - {clip.id for clip in clips})
    if unknown:
        raise UsageError("the list of songs names unknown clips", found=listed(unknown))
    named = []
    for clip in clips:
        record, name, song = records.get(clip.id), parse_name(clip.id), songs.get(clip.id)
        names = (song, clip.music, record and record.music, name and name.music, clip.id)
        music = next(text for text in names if text)
        same = [c for c in (clip, record) if c is not None and song in (None, c.music)]
        tempo = next((c.tempo_bpm for c in same if c.tempo_bpm), None) or tempos.get(music) or tempo_bpm(music)
        named.append(replace(clip, music=music, tempo_bpm=tempo))
    return tuple(named)

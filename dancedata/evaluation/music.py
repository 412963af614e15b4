"""Beats of the music of clips: of the caller, of music files, or of a dataset."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Reject
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid, WindowSpec
from dancedata.core.plugins import AudioFeature
from dancedata.core.registry import FEATURES
from dancedata.core.text import listed
from dancedata.evaluation.clips import ClipSet
from dancedata.evaluation.protocol import MusicRule, Pieces, Protocol, Role
from dancedata.kernel import (
    Cache,
    Clip,
    Executor,
    Field,
    Music,
    MusicField,
    Progress,
    SignalId,
    Store,
    identify_audio,
    run_units,
    song_rows,
)
from dancedata.scene.inputs.clip import ClipInput
from dancedata.scene.inputs.songs import Song

#: Rate of beats where neither the protocol nor a store states one.
_DEFAULT = FrameGrid.of(30)


@dataclass(frozen=True, eq=False)
class Resources:
    """Cache, workers and progress of an evaluation."""

    cache: Cache
    jobs: int | Executor
    progress: Progress


@dataclass(frozen=True, eq=False)
class ClipMusic:
    """Beats of a clip's music.

    `beats`: Frames from the first frame of the clip.
    `end_s`: Length of the music that they are from, seconds; None if unknown.
    `by_piece`: For music that is analysed piece by piece: the beats of the piece that begins at a frame.
    """

    beats: MusicBeats
    end_s: float | None = None
    by_piece: Mapping[int, MusicBeats] | None = None

    @classmethod
    def of_rows(cls, rows: npt.NDArray[Any], field: Field | MusicField) -> Self:
        """Return the beats of rows (T, D) of an audio field."""
        rows = np.asarray(rows)
        return cls(field.beats(rows), float(field.grid.seconds(len(rows))))

    def after(self, start: int, grid: FrameGrid) -> MusicBeats:
        """Return the beats of the piece that begins at frame `start` of `grid`, counted from there."""
        if self.by_piece is not None:
            return self.by_piece.get(start, MusicBeats.of([], self.beats.grid))
        return self.beats.after(start, grid)

    def from_row(self, row: int, grid: FrameGrid) -> Self:
        """Return the beats of music whose row `row`, negative where it begins later, is at the clip's frame 0."""
        if not row:
            return self
        end_s = None if self.end_s is None else self.end_s - float(grid.seconds(row))
        return replace(self, beats=self.beats.after(row, grid), end_s=end_s)

    def from_second(self, begin: Fraction) -> Self:
        """Return the beats of music whose second `begin` is at the clip's frame 0."""
        return self.from_row(begin.numerator, FrameGrid.of(begin.denominator))  # second p / q is row p of q a second

    def identity(self, *, instants: bool) -> list[Any]:
        """Return JSON data for cache keys: frames, and where a metric reads them the instants."""
        pieces = None
        if self.by_piece is not None:
            pieces = [[start, beats.frames.tolist()] for start, beats in sorted(self.by_piece.items())]
        read = [self.beats, *(beats for _, beats in sorted((self.by_piece or {}).items()))] if instants else []
        return [str(self.beats.grid), self.beats.frames.tolist(), pieces, *(b.seconds.tolist() for b in read)]


def clip_music(resources: Resources, protocol: Protocol, clip_set: ClipSet) -> tuple[dict[str, ClipMusic], list[str]]:
    """Return beats by the id of a clip, and problems in words."""
    rule, role, sources = protocol.music, clip_set.role, clip_set.music
    if rule is None or sources is None:
        return {}, []
    clips = clip_set.clips
    music = {clip: ClipMusic(_beats_of(clip, beats, protocol)) for clip, beats in sources.beats.items()}
    problems: list[str] = []
    if sources.files:
        without = [clip for clip in clips if clip.id not in music]
        computed, problems = song_beats(resources, protocol, rule, role, without, sources.files)
        music |= computed
    for store in (clip_set.store, sources.like):
        without = [clip for clip in clips if clip.id not in music]
        if store is not None and without:
            lacking = replace(clip_set, clips=tuple(without))
            stored = stored_beats(store, rule, protocol.pieces(role), lacking, resources.cache.file_sha256)
            problems += about_slices(store, rule) if stored else []
            music |= stored
    silent = sorted({clip.music for clip in clips if clip.id in sources.songs and clip.id not in music})
    if silent and not sources.files:
        problems.append(f"no beats of songs that --music names: {listed(silent)}")
    if not music:
        problems.append(_no_music(rule))
    return music, problems


def _beats_of(clip: str, beats: Any, protocol: Protocol) -> MusicBeats:
    """Return the beats that the caller states, frames at the protocol's rate."""
    if isinstance(beats, MusicBeats):
        return beats
    if protocol.music is None or protocol.music.grid is None:
        raise UsageError(f"{protocol.name} does not state a rate of beats", where=f"clip {clip}",
                         fix="give dancedata.metrics.MusicBeats.of(frames, grid)")  # fmt: skip
    return MusicBeats.of(np.asarray(beats), protocol.music.grid)


def _no_music(rule: MusicRule) -> str:
    rate = f" at {rule.fps} per second" if rule.fps else ""
    alone = ", each piece by itself" if rule.by_piece else ""
    about = f" ({rule.about})" if rule.about else ""
    return (
        f"no beats of music: the protocol takes those of {' or '.join(rule.features)}{rate}{alone}{about}; name "
        "a dataset with that field (like), or the music: a folder, or a CSV file for clips whose ids are not those "
        "of songs or of clips of the dataset"
    )


def song_beats(
    resources: Resources,
    protocol: Protocol,
    rule: MusicRule,
    role: Role,
    clips: Sequence[ClipInput],
    files: Mapping[str, Path],
) -> tuple[dict[str, ClipMusic], list[str]]:
    """Compute the beats of songs that have a file; return them by the id of the clip, and problems in words."""
    field = _music_field(protocol, rule, role)
    clips_with_file = [clip for clip in clips if clip.music in files]
    missing = sorted({clip.music or clip.id for clip in clips} - set(files))
    problems = [f"no music file for {listed(missing)}"] if missing else []
    paths = sorted({files[clip.music] for clip in clips_with_file})
    calls = [(resources.cache, path) for path in paths]
    identified = run_units(
        identify_audio, calls, jobs=resources.jobs, label="decoding music", progress=resources.progress
    )
    signals = dict(zip(paths, identified, strict=True))
    beside = [clip.id for clip in clips_with_file if clip.audio_start and field.windows is not None]
    if beside:
        problems.append(f"no beats piece by piece where music does not begin with its clip: {listed(beside)}")
    timelines = {
        clip.id: (clip, *signal.timeline(clip.audio_start, field.grid))
        for clip in clips_with_file
        if clip.id not in beside and isinstance(signal := signals[files[clip.music]], SignalId)
    }
    songs = {
        clip_id: Music(signal, bpm=clip.tempo_bpm if rule.tempo else None)
        for clip_id, (clip, signal, _) in timelines.items()
    }
    distinct = list(dict.fromkeys(songs.values()))
    rows = song_rows(resources.cache, field, distinct, jobs=resources.jobs, progress=resources.progress)
    rejects = {row.detail: row for of_song in rows.values() for row in of_song if isinstance(row, Reject)}
    beats = {
        song: ClipMusic.of_rows(of_song[0], field) if field.windows is None else _by_piece(of_song, field)
        for song, of_song in rows.items()
        if of_song and not any(isinstance(row, Reject) for row in of_song)
    }
    problems += [reject.detail for reject in (*signals.values(), *rejects.values()) if isinstance(reject, Reject)]
    return {
        clip: beats[song].from_row(timelines[clip][2], field.grid) for clip, song in songs.items() if song in beats
    }, problems


def _music_field(protocol: Protocol, rule: MusicRule, role: Role) -> MusicField:
    name, grid = rule.features[0], rule.grid or _DEFAULT
    if name not in FEATURES.names():
        raise UsageError(f"the beats of {protocol.name} are from the audio feature {name}, which is not installed",
                         found=f"features {', '.join(FEATURES.names())}",
                         fix="take the beats from a dataset that has the field, or leave the music out")  # fmt: skip
    feature: AudioFeature = FEATURES.make(name, {})
    if not rule.by_piece:
        return MusicField(feature.name, grid, feature)
    length, stride = protocol.pieces(role).frames(grid)
    if length is None or stride is None:
        raise UsageError(
            f"{protocol.name}: music by pieces needs pieces", fix="set by_piece of the protocol's music to False"
        )
    return MusicField(feature.name, grid, feature, windows=WindowSpec(length, stride, grid))


def _by_piece(rows: Sequence[Any], field: MusicField) -> ClipMusic:
    """Return the beats of each slice of a song, by the frame at which it begins."""
    starts = map(field.slice_grid.start, range(len(rows)))
    by_piece = {start: field.beats(np.asarray(array)) for start, array in zip(starts, rows, strict=True)}
    return ClipMusic(MusicBeats.of([], field.grid), by_piece=by_piece)


def stored_beats(
    store: Store,
    rule: MusicRule,
    pieces: Pieces,
    clip_set: ClipSet,
    sha256: Callable[[Path], str],
) -> dict[str, ClipMusic]:
    """Return the beats that a store has for clips, by their ids; empty if it has no field of the protocol.

    A clip of the store, or a sample of one, has its own beats. One that is not in the store, or whose song the caller
    names as another one, has those of the longest clip with its song. StoreError if shards have other bytes than the
    build wrote, by `sha256` of files.
    """
    songs = {} if clip_set.music is None else clip_set.music.songs
    name = beat_field(store, rule, pieces)
    if name is None:
        return {}
    records = _records(store)
    # A clip that only names a song begins with it, so rows of a clip that begins later in the song do not fit.
    whole = [c for c in store if c.music and not (c.source or c.slice_of or c.audio_start)]
    longest = {c.music: c.id for c in sorted(whole, key=lambda c: (c.n_frames, c.id))}
    sources: dict[str, tuple[str, Fraction]] = {}
    for clip in clip_set.clips:
        sample, song = clip_set.samples.get(clip.id), songs.get(clip.id)
        record = records.get(clip.clip) if sample is None or sample.store is not store else sample.clip
        if record is not None and song in (None, record.music) and not _is_placed(song):
            sources[clip.id] = record.id, clip.audio_start - record.audio_start
        elif clip.music in longest:
            sources[clip.id] = longest[clip.music], clip.audio_start
    store.require_intact({source for source, _ in sources.values()}, sha256=sha256)
    read = {s: music_of(store, name, s) for s in dict.fromkeys(s for s, _ in sources.values())}
    return {clip: read[s].from_second(begin) for clip, (s, begin) in sources.items()}


def music_of(store: Store, field: str, clip: str) -> ClipMusic:
    """Return the beats that a field has of a clip."""
    first, rows = store[clip].rows_within(field)
    return ClipMusic.of_rows(rows, store.field(field)).from_row(-first, store.field(field).grid)


def _is_placed(song: str | None) -> bool:
    """Return whether the caller states where a clip begins in its song."""
    return isinstance(song, Song) and song.start is not None


def _records(store: Store) -> dict[str, Clip]:
    """Return the clips of a store by id, and of each group the first one by the group's; no copies."""
    clips = [c for c in store if not c.source]
    return {c.group: c for c in reversed(clips) if c.group} | {c.id: c for c in clips}


def beat_field(store: Store, rule: MusicRule, pieces: Pieces) -> str | None:
    """Return the audio field of a store that has the protocol's beats."""
    if store.slice_length not in (None, pieces.frames(store.grid)[0]):
        return None
    if rule.by_piece and store.slice_length is None:
        return None
    fields = [field for field in store.fields_with("beat") if rule.grid in (None, field.grid)]
    named = (field.name for feature in rule.features for field in fields if field.name.split(".")[0] == feature)
    return next(named, None)


def about_slices(store: Store, rule: MusicRule) -> list[str]:
    """Return a warning if a store has beats of each slice alone, and a protocol takes those of whole songs."""
    if rule.by_piece or store.slice_length is None:
        return []
    return [
        "beats are those of each slice of the dataset by itself; the protocol takes those of whole songs: scores of "
        "beats only compare with those of such datasets"
    ]

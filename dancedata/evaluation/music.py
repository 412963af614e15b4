"""Beats of the music of clips: of the caller, of music files, or of a dataset."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple, Self

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
from dancedata.evaluation.protocol import MusicRule, Pieces, Protocol
from dancedata.kernel import (
    Cache,
    Executor,
    Field,
    Music,
    MusicField,
    Progress,
    Sample,
    SignalId,
    Store,
    identify_audio,
    run_units,
    song_rows,
)
from dancedata.scene.inputs.clip import ClipInput
from dancedata.scene.inputs.songs import MusicSources

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
    """Beats of a clip's music."""

    beats: MusicBeats  # frames from the first frame of the clip
    end_s: float | None = None  # length of the music that they are from, seconds; None if unknown
    # for music that is analysed piece by piece: the beats of the piece that begins at a frame
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


class SongPlace(NamedTuple):
    """A music file, the tempo of its song, and its second at the clip's frame 0."""

    path: Path
    tempo_bpm: float | None
    start: Fraction


class StoredPlace(NamedTuple):
    """A clip of a dataset with the field that has its beats, and the second of its music at the clip's frame 0."""

    store: Store
    field: str
    clip: str
    start: Fraction


@dataclass(frozen=True, eq=False)
class MusicPlan:
    """Where the beats of clips are, by the ids of clips; nothing is read yet, and the first that has them counts."""

    rule: MusicRule
    from_caller: Mapping[str, ClipMusic]
    field: MusicField | None  # what computes the beats of `files`; None without any
    files: Mapping[str, SongPlace]
    stored: Mapping[str, StoredPlace]
    problems: tuple[str, ...]  # what is doubtful, in words


#: Plans of the clips, and of the real dances beside them; None where no metric takes music.
MusicPlans = tuple[MusicPlan | None, MusicPlan | None]


def music_plan(protocol: Protocol, clip_set: ClipSet, sources: MusicSources) -> MusicPlan | None:
    """Return where the beats of clips are, without reading them; None for a protocol without music."""
    rule, pieces = protocol.music, protocol.pieces(clip_set.role)
    if rule is None:
        return None
    from_caller = {clip: ClipMusic(_beats_of(clip, beats, protocol)) for clip, beats in sources.beats.items()}
    clips = [clip for clip in clip_set.clips if clip.id not in from_caller]
    field = _music_field(protocol.name, rule, pieces) if sources.files else None
    files = {
        clip.id: SongPlace(sources.files[clip.music], clip.tempo_bpm if rule.tempo else None, clip.audio_start)
        for clip in clips
        if clip.music in sources.files
    }
    stored: dict[str, StoredPlace] = {}
    for store in (clip_set.store, sources.like):
        if store is not None:
            lacking = [clip for clip in clips if clip.id not in stored]
            stored |= _stored_places(store, rule, pieces, lacking, clip_set.samples, sources.songs)
    problems = []
    if field is None:
        silent = {clip.music for clip in clips if clip.id in sources.songs and clip.id not in stored}
        problems += [f"no beats of songs that --music names: {listed(sorted(silent))}"] if silent else []
    else:
        missing = {clip.music or clip.id for clip in clips} - set(sources.files)
        problems += [f"no music file for {listed(sorted(missing))}"] if missing else []
    if field is not None and field.windows is not None and (beside := [clip for clip in files if files[clip].start]):
        problems.append(f"no beats piece by piece where music does not begin with its clip: {listed(beside)}")
        files = {clip: place for clip, place in files.items() if clip not in beside}
    return MusicPlan(rule, from_caller, field, files, stored, tuple(problems))


def read_beats(resources: Resources, plan: MusicPlan | None) -> tuple[dict[str, ClipMusic], list[str]]:
    """Return the beats of a plan by the id of a clip, and problems in words."""
    if plan is None:
        return {}, []
    music, problems = dict(plan.from_caller), list(plan.problems)
    if plan.field is not None:
        computed, unreadable = song_beats(resources, plan.field, plan.files)
        music |= computed
        problems += unreadable
    places = {clip: place for clip, place in plan.stored.items() if clip not in music}
    for store in dict.fromkeys(place.store for place in places.values()):
        read = {place.clip for place in places.values() if place.store is store}
        store.require_intact(read, sha256=resources.cache.file_sha256)
        problems += about_slices(store, plan.rule)
    stored = {of: music_of(*of) for of in dict.fromkeys(place[:3] for place in places.values())}
    music |= {clip: stored[place[:3]].from_second(place.start) for clip, place in places.items()}
    return music, problems if music else [*problems, _no_music(plan.rule)]


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
    resources: Resources, field: MusicField, files: Mapping[str, SongPlace]
) -> tuple[dict[str, ClipMusic], list[str]]:
    """Compute the beats of music files; return them by the id of the clip, and problems in words."""
    cache, jobs, progress = resources.cache, resources.jobs, resources.progress
    paths = sorted({place.path for place in files.values()})
    identified = run_units(
        identify_audio, [(cache, path) for path in paths], jobs=jobs, label="decoding music", progress=progress
    )
    signals = {path: of for path, of in zip(paths, identified, strict=True) if isinstance(of, SignalId)}
    songs: dict[str, Music] = {}
    rows: dict[str, int] = {}
    for clip, place in files.items():
        if place.path in signals:
            signal, rows[clip] = signals[place.path].timeline(place.start, field.grid)
            songs[clip] = Music(signal, bpm=place.tempo_bpm)
    by_song = song_rows(cache, field, list(dict.fromkeys(songs.values())), jobs=jobs, progress=progress)
    rejects = {row.detail: row for of_song in by_song.values() for row in of_song if isinstance(row, Reject)}
    beats = {
        song: ClipMusic.of_rows(of_song[0], field) if field.windows is None else _by_piece(of_song, field)
        for song, of_song in by_song.items()
        if of_song and not any(isinstance(row, Reject) for row in of_song)
    }
    problems = [reject.detail for reject in (*identified, *rejects.values()) if isinstance(reject, Reject)]
    return {
        clip: beats[song].from_row(rows[clip], field.grid) for clip, song in songs.items() if song in beats
    }, problems


def _music_field(protocol: str, rule: MusicRule, pieces: Pieces) -> MusicField:
    name, grid = rule.features[0], rule.grid or _DEFAULT
    if name not in FEATURES.names():
        raise UsageError(f"the beats of {protocol} are from the audio feature {name}, which is not installed",
                         found=f"features {', '.join(FEATURES.names())}",
                         fix="take the beats from a dataset that has the field, or leave the music out")  # fmt: skip
    feature: AudioFeature = FEATURES.make(name, {})
    if not rule.by_piece:
        return MusicField(feature.name, grid, feature)
    length, stride = pieces.frames(grid)
    if length is None or stride is None:
        raise UsageError(
            f"{protocol}: music by pieces needs pieces", fix="set by_piece of the protocol's music to False"
        )
    return MusicField(feature.name, grid, feature, windows=WindowSpec(length, stride, grid))


def _by_piece(rows: Sequence[Any], field: MusicField) -> ClipMusic:
    """Return the beats of each slice of a song, by the frame at which it begins."""
    starts = map(field.slice_grid.start, range(len(rows)))
    by_piece = {start: field.beats(np.asarray(array)) for start, array in zip(starts, rows, strict=True)}
    return ClipMusic(MusicBeats.of([], field.grid), by_piece=by_piece)


def _stored_places(
    store: Store,
    rule: MusicRule,
    pieces: Pieces,
    clips: Sequence[ClipInput],
    samples: Mapping[str, Sample],
    songs: Mapping[str, str],
) -> dict[str, StoredPlace]:
    """Return where a store has beats of clips, by their ids; empty if it has no field of the protocol.

    A clip of the store, or a sample of one, has its own beats. One that is not in the store, or whose song the caller
    names as another one, has those of the longest clip with its song.
    """
    name = beat_field(store, rule, pieces)
    if name is None:
        return {}
    originals = [c for c in store if not c.source]
    records = {c.group: c for c in reversed(originals) if c.group} | {c.id: c for c in originals}
    # A clip that only names a song begins with it, so rows of a clip that begins later in the song do not fit.
    whole = [c for c in originals if c.music and not (c.slice_of or c.audio_start)]
    longest = {c.music: c.id for c in sorted(whole, key=lambda c: (c.n_frames, c.id))}
    places = {}
    for clip in clips:
        sample, song = samples.get(clip.id), songs.get(clip.id)
        record = records.get(clip.clip) if sample is None or sample.store is not store else sample.clip
        if record is not None and song in (None, record.music) and getattr(song, "start", None) is None:
            places[clip.id] = StoredPlace(store, name, record.id, clip.audio_start - record.audio_start)
        elif clip.music in longest:
            places[clip.id] = StoredPlace(store, name, longest[clip.music], clip.audio_start)
    return places


def music_of(store: Store, field: str, clip: str) -> ClipMusic:
    """Return the beats that a field has of a clip."""
    first, rows = store[clip].rows_within(field)
    return ClipMusic.of_rows(rows, store.field(field)).from_row(-first, store.field(field).grid)


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

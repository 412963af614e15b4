"""Beats of the music of clips: of the caller, of music files, or of a dataset; names of songs."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.clip import Reject, Window
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import AudioFeature
from dancedata.core.registry import FEATURES
from dancedata.core.text import csv_text, listed, quoted
from dancedata.datasets.aistpp import parse_name, tempo_bpm
from dancedata.datasets.files import AUDIO_SUFFIXES, best_audio, group_by_stem
from dancedata.datasets.folder import MUSIC_FOLDERS
from dancedata.evaluation.clip_music import BEAT, ClipMusic, field_beats
from dancedata.evaluation.inputs.clip import ClipInput, ClipSet
from dancedata.evaluation.inputs.store import StoreClip
from dancedata.evaluation.measuring import Resources
from dancedata.evaluation.protocol import MusicRule, Pieces, Protocol, Role
from dancedata.execution.units import run_units
from dancedata.pipeline.audio import (
    FeatureKeys,
    SignalId,
    extract_track,
    extract_windows,
    identify_audio,
    known_windows,
    window_samples,
    window_units,
)
from dancedata.recipes.fields import FeatureJob, WindowSpec
from dancedata.recipes.plugins import make_named
from dancedata.store import Store
from dancedata.store.listed_file import FileHash

_MAX_CSV_BYTES = 1 << 24
#: Rate of beats where neither the protocol nor a store states one.
_DEFAULT = FrameGrid.of(30)


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


def song_files(folder: Path) -> dict[str, Path]:
    """Return the music files of a folder, or of its folder of music, by their names without suffix.

    Raises
    ------
    UsageError
        If there are none.
    """
    for place in (folder, *(folder / name for name in MUSIC_FOLDERS)):
        by_stem = group_by_stem([place], AUDIO_SUFFIXES) if place.is_dir() else []
        if by_stem:
            return {stem: best_audio(paths)[0] for stem, paths in by_stem}
    raise UsageError(
        "no music in the folder", where=folder,
        allowed=f"files {', '.join(AUDIO_SUFFIXES)}, here or in {listed(f'{name}/' for name in MUSIC_FOLDERS)}",
    )  # fmt: skip


def song_beats(
    resources: Resources,
    protocol: Protocol,
    rule: MusicRule,
    role: Role,
    clips: Sequence[ClipInput],
    files: Mapping[str, Path],
) -> tuple[dict[str, ClipMusic], list[str]]:
    """Compute the beats of the songs of clips; those without a file of their song's name are not in the result.

    Returns
    -------
    beats, problems
        Beats by the id of the clip, and songs that cannot be used, in words.

    Raises
    ------
    UsageError
        If the feature of the protocol is not installed.
    """
    job = _job(protocol, rule, role)
    clips_with_file = [clip for clip in clips if clip.music in files]
    missing = sorted({clip.music for clip in clips} - set(files))
    problems = [f"no music file for {listed(missing)}"] if missing else []
    paths = sorted({files[clip.music] for clip in clips_with_file})
    calls = [(resources.cache, path) for path in paths]
    identified = run_units(
        identify_audio, calls, jobs=resources.jobs, label="decoding music", progress=resources.progress
    )
    signals = dict(zip(paths, identified, strict=True))
    songs = {
        clip.id: _Song(signal, clip.tempo_bpm if rule.tempo else None)
        for clip in clips_with_file
        if isinstance(signal := signals[files[clip.music]], SignalId)
    }
    compute = _tracks if job.windows is None else _windows
    beats, rejects = compute(resources, job, list(dict.fromkeys(songs.values())))
    problems += [reject.detail for reject in (*signals.values(), *rejects) if isinstance(reject, Reject)]
    return {clip: beats[song] for clip, song in songs.items() if song in beats}, problems


@dataclass(frozen=True)
class _Song:
    """A signal and the tempo that the beat tracker starts from."""

    signal: SignalId
    bpm: float | None


def _job(protocol: Protocol, rule: MusicRule, role: Role) -> FeatureJob:
    feature, grid = _feature(protocol, rule), rule.grid or _DEFAULT
    if rule.scope == "track":
        return FeatureJob(feature.name, grid, feature)
    length, stride = protocol.pieces(role).frames(grid)
    if length is None or stride is None:
        raise UsageError(
            f"{protocol.name}: music by pieces needs pieces", fix="set the protocol's music to scope track"
        )
    return FeatureJob(feature.name, grid, feature, WindowSpec(length, stride, grid))


def _feature(protocol: Protocol, rule: MusicRule) -> AudioFeature:
    name = rule.features[0]
    if name not in FEATURES.names():
        raise UsageError(
            f"the beats of {protocol.name} are from the audio feature {name}, which is not installed",
            found=f"features {', '.join(FEATURES.names())}",
            fix="take the beats from a dataset that has the field, or leave out --source",
        )
    return make_named(FEATURES, "audio", name, {})


_Beats = tuple[dict[_Song, ClipMusic], list[Reject]]


def _tracks(resources: Resources, job: FeatureJob, songs: Sequence[_Song]) -> _Beats:
    feature_keys = FeatureKeys(job)
    keys = [feature_keys.track(song.bpm, song.signal.sha256) for song in songs]
    calls = [(resources.cache, job, song.signal, song.bpm, key) for song, key in zip(songs, keys, strict=True)]
    results = _run(resources, job, extract_track, calls, [resources.cache.array("features", key) for key in keys])
    beats = {
        song: ClipMusic.of_rows(rows, job)
        for song, rows in zip(songs, results, strict=True)
        if not isinstance(rows, Reject)
    }
    return beats, [result for result in results if isinstance(result, Reject)]


def _windows(resources: Resources, job: FeatureJob, songs: Sequence[_Song]) -> _Beats:
    feature_keys = FeatureKeys(job)
    units: list[tuple[_Song, dict[int, str]]] = []
    for song in songs:
        count = len(window_samples(job, song.signal.n_samples, song.signal.sample_rate)[0])
        keys = {number: feature_keys.window(song.bpm, song.signal, number) for number in range(count)}
        units += [(song, unit) for unit in window_units(keys)] if keys else []
    calls = [(resources.cache, job, song.signal, song.bpm, unit) for song, unit in units]
    cached = [known_windows(resources.cache, unit) for _, unit in units]
    results = _run(resources, job, extract_windows, calls, cached)
    pieces: dict[_Song, dict[int, MusicBeats]] = {}
    for (song, _), windows in zip(units, results, strict=True):
        if not isinstance(windows, Reject):
            by_piece = pieces.setdefault(song, {})
            for number, rows in windows.items():
                by_piece[job.window_spec.start(number)] = field_beats(np.asarray(rows), job)
    nothing = MusicBeats.of([], job.grid)
    beats = {song: ClipMusic(nothing, by_piece=by_piece) for song, by_piece in pieces.items()}
    return beats, [result for result in results if isinstance(result, Reject)]


def _run(
    resources: Resources, job: FeatureJob, unit: Callable[..., Any], calls: Sequence[Any], cached: Sequence[Any]
) -> list[Any]:
    return run_units(
        unit, calls, known=cached, jobs=resources.jobs, label=f"beats, {job.name}", progress=resources.progress,
        exact=job.feature.exact,
    )  # fmt: skip


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
    fields = [field for field in store.fields_with(BEAT) if rule.grid in (None, field.grid)]
    named = (field.name for feature in rule.features for field in fields if field.name.split(".")[0] == feature)
    return next(named, None)


def about_windows(store: Store, rule: MusicRule) -> list[str]:
    """Return a warning if a store has beats of each window alone, and a protocol takes those of whole songs."""
    if store.scope == "track" or rule.scope == "window":
        return []
    return [
        "beats are those of each window by itself, as the dataset is of window scope; the protocol takes those of "
        "whole songs: scores of beats only compare with those of such datasets"
    ]


def song_name(text: str) -> str:
    """Return the name of a song: that of a music file without folder and suffix, any other text unchanged."""
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

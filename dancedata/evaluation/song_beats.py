"""Beats of music files: each song is decoded and analysed once, as in a build and in its cache."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.clip import Reject
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import AudioFeature
from dancedata.core.registry import FEATURES
from dancedata.core.text import listed
from dancedata.datasets.files import AUDIO_SUFFIXES, best_audio, group_by_stem
from dancedata.datasets.folder import MUSIC_FOLDERS
from dancedata.evaluation.clip_music import ClipMusic, field_beats
from dancedata.evaluation.inputs.clip import ClipInput
from dancedata.evaluation.protocol import MusicRule, Protocol, Role
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
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

__all__ = ["song_beats", "song_files"]

#: Rate of beats where neither the protocol nor a store states one.
_DEFAULT = FrameGrid.of(30)


def song_files(folder: Path) -> dict[str, Path]:
    """Return the music files of a folder, or else of its folder of music, by their names without suffix.

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
    cache: Cache,
    protocol: Protocol,
    role: Role,
    clips: Sequence[ClipInput],
    files: Mapping[str, Path],
    *,
    jobs: Jobs,
    progress: Progress,
) -> tuple[dict[str, ClipMusic], list[str]]:
    """Compute the beats of the songs of clips; those without a file of their song's name are not in the result.

    Parameters
    ----------
    files
        Music files by name.

    Returns
    -------
    beats, problems
        Beats by the id of the clip, and songs that cannot be used, in words.

    Raises
    ------
    UsageError
        If the feature of the protocol is not installed.
    """
    rule = protocol.music
    if rule is None:
        return {}, []
    job = _job(protocol, rule, role)
    asked = [clip for clip in clips if clip.music in files]
    missing = sorted({clip.music for clip in clips} - set(files))
    problems = [f"no music file for {listed(missing)}"] if missing else []
    paths = sorted({files[clip.music] for clip in asked})
    calls = [(cache, path) for path in paths]
    found = run_units(identify_audio, calls, jobs=jobs, label="decoding music", progress=progress)
    signals = dict(zip(paths, found, strict=True))
    songs = {
        clip.id: _Song(signal, clip.tempo_bpm if rule.tempo else None)
        for clip in asked
        if isinstance(signal := signals[files[clip.music]], SignalId)
    }
    compute = _windows if job.windows is not None else _tracks
    beats, failed = compute(cache, job, list(dict.fromkeys(songs.values())), jobs=jobs, progress=progress)
    problems += [r.detail for r in (*signals.values(), *failed) if isinstance(r, Reject)]
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


Found = tuple[dict[_Song, ClipMusic], list[Any]]


def _tracks(cache: Cache, job: FeatureJob, songs: Sequence[_Song], *, jobs: Jobs, progress: Progress) -> Found:
    every = FeatureKeys(job)
    keys = [every.track(song.bpm, song.signal.sha256) for song in songs]
    calls = [(cache, job, song.signal, song.bpm, key) for song, key in zip(songs, keys, strict=True)]
    known = [cache.array("features", key) for key in keys]
    rows = run_units(
        extract_track, calls, known=known, jobs=jobs, label=f"beats, {job.name}", progress=progress,
        exact=job.feature.exact,
    )  # fmt: skip
    beats = {
        song: ClipMusic.of_rows(np.asarray(found), job)
        for song, found in zip(songs, rows, strict=True)
        if not isinstance(found, Reject)
    }
    return beats, rows


def _windows(cache: Cache, job: FeatureJob, songs: Sequence[_Song], *, jobs: Jobs, progress: Progress) -> Found:
    every = FeatureKeys(job)
    units: list[tuple[_Song, dict[int, str]]] = []
    for song in songs:
        count = len(window_samples(job, song.signal.n_samples, song.signal.sample_rate)[0])
        keys = {number: every.window(song.bpm, song.signal, number) for number in range(count)}
        units += [(song, unit) for unit in window_units(keys)] if keys else []
    calls = [(cache, job, song.signal, song.bpm, unit) for song, unit in units]
    known = [known_windows(cache, unit) for _, unit in units]
    rows = run_units(
        extract_windows, calls, known=known, jobs=jobs, label=f"beats, {job.name}", progress=progress,
        exact=job.feature.exact,
    )  # fmt: skip
    pieces: dict[_Song, dict[int, MusicBeats]] = {}
    for (song, _), found in zip(units, rows, strict=True):
        if not isinstance(found, Reject):
            own = pieces.setdefault(song, {})
            for number, window in found.items():
                own[job.window_spec.start(number)] = field_beats(np.asarray(window), job)
    nothing = MusicBeats.of([], job.grid)
    return {song: ClipMusic(nothing, by_piece=own) for song, own in pieces.items()}, rows

"""Beats of music files: each song is decoded and analysed once, by the units and the cache of builds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
from dancedata.evaluation.measuring import Resources
from dancedata.evaluation.protocol import MusicRule, Protocol, Role
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

#: Rate of beats where neither the protocol nor a store states one.
_DEFAULT = FrameGrid.of(30)


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

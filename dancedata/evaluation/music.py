"""Beats of the music of each clip: from a store's column, from music files, or given."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Reject
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import FEATURES
from dancedata.core.text import listed
from dancedata.datasets._source import AUDIO_SUFFIXES, best_audio
from dancedata.datasets.aistpp.facts import parse_name, tempo_bpm
from dancedata.evaluation.inputs.clip import ClipInput
from dancedata.evaluation.inputs.store import StoreClip
from dancedata.evaluation.protocol import MusicRule, Pieces, Protocol
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
from dancedata.pipeline.audio import FeatureKeys, SignalId, extract_track, identify_audio
from dancedata.recipes.fields import FeatureJob
from dancedata.recipes.plugins import make_named
from dancedata.store import Store

__all__ = ["ClipMusic", "beats_after", "beats_of_rows", "read_songs", "song_files", "stored_beats"]

#: Group of the beats in an audio feature.
BEAT = "beat"
_MAX_CSV_BYTES = 1 << 24


@dataclass(frozen=True, eq=False)
class ClipMusic:
    """Beats of a clip's music.

    Attributes
    ----------
    beats
        Frames from the first frame of the clip.
    end
        Frames of the music, of the same grid; None if unknown.
    """

    beats: MusicBeats
    end: int | None = None


def beats_of_rows(rows: npt.NDArray[Any], column: int, grid: FrameGrid) -> ClipMusic:
    """Return the beats of feature rows (T, D): where the column is not 0."""
    return ClipMusic(MusicBeats.of(np.flatnonzero(np.asarray(rows)[:, column]), grid), len(rows))


def beats_after(beats: MusicBeats, start: int, grid: FrameGrid) -> MusicBeats:
    """Return the beats at or after frame `start` of `grid`, counted from there."""
    if grid.is_whole(start, of=beats.grid):
        frames, rate = beats.frames - grid.rows(start, of=beats.grid), beats.grid
    else:
        own, clip = beats.grid.rate, grid.rate
        rate = FrameGrid(Fraction(own.numerator * clip.numerator))
        frames = beats.frames * (own.denominator * clip.numerator) - start * clip.denominator * own.numerator
    return MusicBeats(frames[frames >= 0], rate)


def stored_beats(store: Store, rule: MusicRule, pieces: Pieces, clips: Sequence[ClipInput]) -> dict[str, ClipMusic]:
    """Return the beats that a store has for clips, by their ids; empty if it has no field of the protocol.

    A clip takes its own rows, or, if it is not in the store, those of the longest clip with the same music.
    """
    name = _field(store, rule, pieces)
    if name is None:
        return {}
    column = store.fields[name].slice(BEAT).start
    grid = store.field(name).grid
    records = {c.id: c for c in store.clips if not c.source}
    longest: dict[str, str] = {}
    for record in sorted(records.values(), key=lambda c: (c.n_frames, c.id)):
        if record.music:
            longest[record.music] = record.id
    found = {}
    for clip in clips:
        if isinstance(clip, StoreClip) and clip.window is not None and clip.reference == store.reference:
            found[clip.id] = beats_of_rows(store.read(clip.window, name), column, grid)
            continue
        source = clip.id if clip.id in records else longest.get(clip.music)
        if source is not None and store.scope == "track":
            found[clip.id] = beats_of_rows(store.read_clip(source, name), column, grid)
    return found


def _field(store: Store, rule: MusicRule, pieces: Pieces) -> str | None:
    """Return the audio field of a store that has the protocol's beats."""
    if store.scope != rule.scope or (rule.scope == "window" and store.meta["windows"]["length"] != pieces.length):
        return None
    for feature in rule.features:
        for name, columns in store.fields.items():
            if name.split(".")[0] == feature and BEAT in columns.names and rule.grid in (None, store.field(name).grid):
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
                "a line has another number of columns", where=f"{path}, line {number}", found=len(line), allowed="clip,song"
            )
        songs[line[0].strip()] = Path(line[1].strip()).stem
    return songs


def named_songs(clips: Sequence[ClipInput], songs: Mapping[str, str], like: Store | None) -> list[ClipInput]:
    """Return the clips with the names of their songs: from a list, a store's clip of that id, AIST++'s names, or their own."""
    records = {} if like is None else {c.id: c for c in like.clips}
    unknown = sorted(set(songs) - {clip.id for clip in clips})
    if unknown:
        raise UsageError("the list of songs names clips that are not there", found=listed(unknown))
    named = []
    for clip in clips:
        record, name = records.get(clip.id), parse_name(clip.id)
        music = songs.get(clip.id) or clip.music or (record.music if record else "") or (name.music if name else clip.id)
        tempo = clip.tempo_bpm or (record.tempo_bpm if record else None) or tempo_bpm(music)
        named.append(replace(clip, music=music, tempo_bpm=tempo))
    return named


def song_files(folder: Path) -> dict[str, Path]:
    """Return the music files of a folder by their names without suffix.

    Raises
    ------
    UsageError
        If there are none.
    """
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.suffix.lower() in AUDIO_SUFFIXES and path.is_file():
            found.setdefault(path.stem, []).append(path)
    if not found:
        raise UsageError("no music in the folder", where=folder, allowed=f"files {', '.join(AUDIO_SUFFIXES)}")
    return {stem: best_audio(paths)[0] for stem, paths in found.items()}


def computed_beats(
    cache: Cache,
    protocol: Protocol,
    clips: Sequence[ClipInput],
    files: Mapping[str, Path],
    grid: FrameGrid,
    *,
    jobs: Jobs,
    progress: Progress,
) -> tuple[dict[str, ClipMusic], list[Reject]]:
    """Compute the beats of the songs of clips, each song once, as a build does and in its cache.

    Parameters
    ----------
    files
        Music files by name.
    grid
        Rate where the protocol names none.

    Raises
    ------
    UsageError
        If the feature of the protocol is not installed.
    """
    rule = protocol.music
    if rule is None:
        return {}, []
    feature = _feature(protocol, rule)
    job = FeatureJob(feature.name, rule.grid or grid, feature)
    with_file = [clip for clip in clips if clip.music in files]
    paths = sorted({files[clip.music] for clip in with_file})
    signals = dict(
        zip(
            paths,
            run_units(identify_audio, [(cache, p) for p in paths], jobs=jobs, label="decoding music", progress=progress),
            strict=True,
        )
    )
    keys = FeatureKeys(job)
    units: dict[str, tuple[Any, ...]] = {}
    key_of: dict[str, str] = {}
    for clip in with_file:
        signal = signals[files[clip.music]]
        if isinstance(signal, SignalId):
            bpm = clip.tempo_bpm if rule.tempo else None
            key_of[clip.id] = key = keys.track(bpm, signal.sha256)
            units[key] = (cache, job, signal, bpm, key)
    known = [cache.array("features", key) for key in units]
    rows = dict(
        zip(
            units,
            run_units(
                extract_track, list(units.values()), known=known, jobs=jobs, label=f"beats, {job.name}",
                progress=progress, exact=feature.exact,
            ),
            strict=True,
        )
    )  # fmt: skip
    column = job.columns.slice(BEAT).start
    found = {
        clip: beats_of_rows(np.asarray(rows[key]), column, job.grid)
        for clip, key in key_of.items()
        if not isinstance(rows[key], Reject)
    }
    rejects = [r for r in (*signals.values(), *rows.values()) if isinstance(r, Reject)]
    return found, rejects


def _feature(protocol: Protocol, rule: MusicRule) -> Any:
    name = rule.features[0]
    if name not in FEATURES.names():
        raise UsageError(
            f"the beats of {protocol.name} are from the audio feature {name}, which is not installed",
            found=f"features {', '.join(FEATURES.names())}",
            fix="take the beats from a dataset that has the field, or leave out --source",
        )
    return make_named(FEATURES, "audio", name, {})

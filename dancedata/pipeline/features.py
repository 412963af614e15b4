"""Stage 4, windowed clips -> extracted clips: features of each signal or window, once for all its clips."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dancedata.audio.file import Placed
from dancedata.audio.networks.feature import NetworkFeature
from dancedata.core.clip import Reject
from dancedata.core.errors import StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.licence import Licence
from dancedata.core.plugins import AudioFeature
from dancedata.execution.cache import Cache, CachedArray
from dancedata.execution.executors import Executor
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
from dancedata.pipeline.audio import (
    FeatureKeys,
    SignalId,
    extract_track,
    extract_windows,
    known_windows,
    timeline_of,
    window_units,
)
from dancedata.pipeline.feature_files import FeatureFile, extract_file, file_key, place
from dancedata.pipeline.motion import MotionResult
from dancedata.pipeline.sources import SourceClip
from dancedata.pipeline.windows import WindowedClip
from dancedata.recipes.fields import FeatureJob
from dancedata.recipes.recipe import Recipe
from dancedata.store import AudioBlock, Signal, StoredClip

Blocks = tuple[AudioBlock, ...]


@dataclass(frozen=True)
class ExtractedClip:
    """A clip with the blocks of rows of every audio field, by name."""

    source: SourceClip
    motion: MotionResult
    starts: tuple[int, ...]
    audio: Mapping[str, Blocks]

    @property
    def flags(self) -> list[dict[str, Any]]:
        """Quality flags of motion and music."""
        return [*self.motion.flags, *self.source.music_flags(self.motion.seconds)]


def extract_features(
    cache: Cache, recipe: Recipe, clips: Sequence[WindowedClip], *, jobs: Jobs, progress: Progress
) -> tuple[list[ExtractedClip], list[Reject]]:
    """Extract all audio fields; a clip whose music fails is left out and skipped for later fields."""
    audio: dict[str, dict[str, Blocks]] = {clip.source.ref.id: {} for clip in clips}
    left, rejects = list(clips), []
    for job in recipe.audio:
        extraction = _Extraction(cache, recipe, job, left, jobs, progress)
        if job.feature.from_files:
            extracted, failed = extraction.files()
        else:
            extracted, failed = extraction.tracks() if recipe.scope == "track" else extraction.windows()
        for clip, blocks in extracted.items():
            audio[clip][job.name] = blocks
        rejects += [replace(reject, clip=clip) for clip, reject in failed.items()]
        left = [clip for clip in left if clip.source.ref.id in extracted]
    return [ExtractedClip(c.source, c.motion, c.starts, audio[c.source.ref.id]) for c in left], rejects


def stored_clip(recipe: Recipe, clip: ExtractedClip) -> StoredClip:
    """Return a clip as it is stored."""
    ref, motion, signal = clip.source.ref, clip.motion, clip.source.signal
    of_motion = {job.name: job for job in recipe.file_jobs if job.feature.of_motion}
    frames = motion.n_frames if recipe.scope == "track" else recipe.windows.length
    from_files = {
        name: _OwnRows(clip.audio[name], frames, recipe.grid, job, recipe.scope == "window")
        for name, job in of_motion.items()
    }
    return StoredClip(
        id=ref.id,
        split=ref.split,
        genre=ref.genre,
        music=ref.music,
        dancer=ref.dancer,
        tempo_bpm=ref.tempo_bpm,
        n_flags=len(clip.flags),
        trim_start=motion.trim_start,
        height_m=motion.height_m,
        source_rate=str(motion.source_rate),
        lists=ref.lists,
        n_frames=motion.n_frames,
        starts=clip.starts,
        motion={**motion.stored(recipe, clip.starts), **from_files},
        audio={name: blocks for name, blocks in clip.audio.items() if name not in of_motion},
        group=ref.group,
        member=ref.member,
        role=ref.role,
        song="" if signal is None else ref.music or signal.sha256[:12],
        signal=None if signal is None else Signal(signal.sha256, signal.sample_rate, signal.n_samples),
        source_start=ref.source_start,
        source_end=ref.source_end,
        audio_start=ref.audio_start,
        audio_start_by=ref.audio_start_by,
        terms=Licence(ref.licence, ref.citation) if ref.licence or ref.citation else None,
        made_of=clip.source.made_of,
        columns={**dict(ref.keys), **dict(ref.columns)},
    )


@dataclass(frozen=True)
class _OwnRows:
    """Rows of motion from a file: (T, D) of a clip, or (W, L, D) of its windows; codes are filled up with the pad.

    `frames` are those of the clip, or of a window.
    """

    blocks: Blocks
    frames: int
    grid: FrameGrid
    job: FeatureJob
    by_window: bool

    @property
    def shape(self) -> tuple[int, ...]:
        first = self.blocks[0]
        rows = min(self.grid.rows_up(self.frames, of=self.job.grid), first.array.shape[0] - first.offset)
        rows = max(rows, self.grid.rows_down(self.frames, of=self.job.grid))
        return (*([len(self.blocks)] if self.by_window else []), rows, first.array.shape[1])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        array, codebook = np.asarray(self.blocks[0].array), self.job.codebook  # blocks are of one file
        out = np.full(self.shape, 0 if codebook is None else codebook.pad, array.dtype)
        for rows, block in zip(out if self.by_window else out[np.newaxis], self.blocks, strict=True):
            found = array[block.offset : block.offset + len(rows)]
            rows[: len(found)] = found
        return np.asarray(out, dtype=dtype)


class _Window(NamedTuple):
    """A window's rows: their key, and the song that they are computed from, with the tempo to start from."""

    key: str
    song: tuple[SignalId, float | None]


@dataclass(frozen=True)
class _Extraction:
    """The extraction of one field."""

    cache: Cache
    recipe: Recipe
    job: FeatureJob
    clips: Sequence[WindowedClip]
    jobs: Jobs
    progress: Progress

    def tracks(self) -> tuple[dict[str, Blocks], dict[str, Reject]]:
        """Return a block, or a reject, for each clip; clips of equal music and tempo share it."""
        feature_keys = FeatureKeys(self.job)
        timelines: dict[str, list[str]] = {}
        offsets: dict[str, int] = {}
        units: dict[str, _Unit] = {}
        for clip in self.clips:
            ref = clip.source.ref
            bpm = ref.tempo_bpm
            signal, offsets[ref.id] = timeline_of(_signal(clip), ref.audio_start, self.job.grid)
            key = feature_keys.track(bpm, signal.sha256)
            units.setdefault(key, _Unit(signal, bpm, key))
            timelines.setdefault(key, []).append(ref.id)
        cached = [self.cache.array("features", key) for key in timelines]
        results = self._run(extract_track, list(units.values()), cached)
        blocks: dict[str, Blocks] = {}
        failed: dict[str, Reject] = {}
        for (key, clips), result in zip(timelines.items(), results, strict=True):
            for clip_id in clips:
                if isinstance(result, Reject):
                    failed[clip_id] = result
                else:
                    blocks[clip_id] = (AudioBlock(key, result, offsets[clip_id]),)
        return blocks, failed

    def windows(self) -> tuple[dict[str, Blocks], dict[str, Reject]]:
        """Return a block for each window, or a reject; the same window of equal songs, at one tempo, shares it."""
        feature_keys = FeatureKeys(self.job)
        by_clip: dict[str, list[_Window]] = {}
        owner: dict[str, _Window] = {}
        songs: dict[tuple[SignalId, float | None], dict[int, str]] = {}
        for clip in self.clips:
            signal, bpm = _signal(clip), clip.source.ref.tempo_bpm
            numbered = songs.setdefault((signal, bpm), {})
            of_clip = by_clip[clip.source.ref.id] = []
            for number in self.recipe.windows.numbers(clip.starts):
                key = numbered.get(number) or feature_keys.window(bpm, signal, number)
                window = owner.setdefault(key, _Window(key, (signal, bpm)))
                if window.song == (signal, bpm):
                    numbered[number] = key
                of_clip.append(window)
        units = [_Unit(signal, bpm, keys) for (signal, bpm), song in songs.items() for keys in window_units(song)]
        arrays, broken = self._compute_windows(units)
        blocks: dict[str, Blocks] = {}
        failed: dict[str, Reject] = {}
        for clip_id, windows in by_clip.items():
            missing = [window for window in windows if window.key not in arrays]
            if missing:
                failed[clip_id] = broken[missing[0].song[0]]
            else:
                blocks[clip_id] = tuple(AudioBlock(window.key, arrays[window.key]) for window in windows)
        return blocks, failed

    def files(self) -> tuple[dict[str, Blocks], dict[str, Reject]]:
        """Return blocks of each clip's file, one in track scope, one per window; equal files share their rows."""
        job = self.job
        units: dict[str, tuple[FeatureFile, Placed]] = {}
        by_clip: dict[str, tuple[str, int]] = {}
        for clip in self.clips:
            file = clip.source.files[job.name]
            placed = place(job, clip.source.ref, file.n_rows)
            key = file_key(job, file.sha256, placed)
            units.setdefault(key, (file, placed))
            by_clip[clip.source.ref.id] = key, -placed.first
        results = run_units(
            extract_file,
            [(self.cache, job, *unit, key) for key, unit in units.items()],
            cached=[self.cache.array("features", key) for key in units],
            jobs=self.jobs,
            label=job.name,
            progress=self.progress,
        )
        found = dict(zip(units, results, strict=True))
        blocks: dict[str, Blocks] = {}
        failed: dict[str, Reject] = {}
        for clip in self.clips:
            key, offset = by_clip[clip.source.ref.id]
            result = found[key]
            if isinstance(result, Reject):
                failed[clip.source.ref.id] = result
                continue
            firsts = [0] if self.recipe.scope == "track" else clip.starts
            rows = [self.recipe.grid.rows(first, of=job.grid) for first in firsts]
            blocks[clip.source.ref.id] = tuple(AudioBlock(key, result, offset + row) for row in rows)
        return blocks, failed

    def _compute_windows(self, units: Sequence[_Unit]) -> tuple[dict[str, CachedArray], dict[SignalId, Reject]]:
        """Return rows by key, and failures by song."""
        cached = [known_windows(self.cache, unit.keys) for unit in units]
        arrays: dict[str, CachedArray] = {}
        broken: dict[SignalId, Reject] = {}
        for unit, result in zip(units, self._run(extract_windows, units, cached), strict=True):
            if isinstance(result, Reject):
                broken[unit.signal] = result
            else:
                arrays.update({unit.keys[number]: array for number, array in result.items()})
        return arrays, broken

    def _run(self, function: Callable[..., Any], units: Sequence[_Unit], cached: list[Any]) -> list[Any]:
        """Run the units of work that are not cached, each with the file of the next song."""
        missing = [unit.signal.path for unit, result in zip(units, cached, strict=True) if result is None]
        ahead = iter(_next_songs(self.job.feature, missing))
        calls = [
            (self.cache, self.job, *unit, next(ahead) if result is None else None)
            for unit, result in zip(units, cached, strict=True)
        ]
        # Devices are looked up only if there is something to compute.
        jobs = _jobs_for(self.job.feature, self.jobs) if missing else self.jobs
        return run_units(
            function,
            calls,
            cached=cached,
            jobs=jobs,
            label=self.job.name,
            progress=self.progress,
            exact=self.job.feature.exact,
        )


class _Unit(NamedTuple):
    """A unit of work: a song, the tempo to start from, and the key, or keys by number, of its rows."""

    signal: SignalId
    bpm: float | None
    keys: Any


def _signal(clip: WindowedClip) -> SignalId:
    if clip.source.signal is None:
        raise StoreError("a clip without music reached the audio features", where=f"clip {clip.source.ref.id}")
    return clip.source.signal


def _jobs_for(feature: AudioFeature, jobs: Jobs) -> Jobs:
    """Return the workers for a feature: one that computes on cards takes one process per card."""
    if not isinstance(feature, NetworkFeature):
        return jobs
    return replace(jobs, n=feature.workers(jobs.n)) if isinstance(jobs, Executor) else feature.workers(jobs)


def _next_songs(feature: AudioFeature, songs: Sequence[Path]) -> list[Path | None]:
    """Return, for each unit of work, the file of the next one, if the feature computes on a device."""
    if not (isinstance(feature, NetworkFeature) and feature.prefetch):
        return [None] * len(songs)
    return [after if after != path else None for path, after in zip(songs, [*songs[1:], None], strict=False)]

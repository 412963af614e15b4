"""Extracts all audio features of a build: each signal's or window's once, whatever files and clips it is in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dancedata.core.clip import Reject
from dancedata.core.plugins import AudioFeature
from dancedata.execution.cache import Cache, CachedArray
from dancedata.execution.execute import Progress, run_units
from dancedata.execution.workers import Jobs, Workers
from dancedata.pipeline.audio import (
    FeatureKeys,
    SignalId,
    extract_track,
    extract_windows,
    known_windows,
    window_units,
)
from dancedata.pipeline.gathered import Gathered, window_numbers
from dancedata.store import AudioBlock


def extract_all(
    cache: Cache, gathered: Gathered, starts: dict[str, tuple[int, ...]], *, jobs: Jobs, progress: Progress
) -> dict[str, dict[str, tuple[AudioBlock, ...]]]:
    """Return per clip and feature the blocks of rows; clips whose music fails are set aside.

    Parameters
    ----------
    starts
        First frames of each clip's windows.
    """
    audio: dict[str, dict[str, tuple[AudioBlock, ...]]] = {clip: {} for clip in gathered.refs}
    for feature in gathered.recipe.audio:
        extraction = _Extraction(cache, gathered, feature, jobs, progress)
        found = extraction.tracks() if gathered.recipe.scope == "track" else extraction.windows(starts)
        for clip, blocks in found.items():
            audio[clip][feature.name] = blocks
    return {clip: blocks for clip, blocks in audio.items() if clip in gathered.refs}


@dataclass(frozen=True)
class _Extraction:
    """The extraction of one feature."""

    cache: Cache
    gathered: Gathered
    feature: AudioFeature
    jobs: Jobs
    progress: Progress

    def tracks(self) -> dict[str, tuple[AudioBlock, ...]]:
        """Return a block for every clip; clips of equal music and tempo share theirs."""
        gathered, every = self.gathered, FeatureKeys(self.gathered.recipe, self.feature)
        timelines: dict[str, list[str]] = {}
        calls: dict[str, tuple[Any, ...]] = {}
        for ref in gathered.refs.values():
            signal, bpm = gathered.need_signal(ref), ref.tempo_bpm
            key = every.track(bpm, signal.sha256)
            calls.setdefault(key, (self.cache, gathered.recipe, self.feature, signal, bpm, key))
            timelines.setdefault(key, []).append(ref.id)
        known = [self.cache.array("features", key) for key in timelines]
        results = self._run(extract_track, list(calls.values()), known)
        found: dict[str, tuple[AudioBlock, ...]] = {}
        for (key, clips), result in zip(timelines.items(), results, strict=True):
            for clip in clips:
                if isinstance(result, Reject):
                    gathered.drop(clip, result)
                else:
                    found[clip] = (AudioBlock(key, result),)
        return found

    def windows(self, starts: dict[str, tuple[int, ...]]) -> dict[str, tuple[AudioBlock, ...]]:
        """Return a block for every window; the same window of equal songs, at one tempo, has one."""
        gathered, every = self.gathered, FeatureKeys(self.gathered.recipe, self.feature)
        wanted: dict[str, list[str]] = {}
        owner: dict[str, tuple[Path, float | None]] = {}
        songs: dict[tuple[Path, float | None], dict[int, str]] = {}
        for ref in gathered.refs.values():
            signal, bpm = gathered.need_signal(ref), ref.tempo_bpm
            song = songs.setdefault((signal.path, bpm), {})
            wanted[ref.id] = []
            for number in window_numbers(gathered.recipe, starts[ref.id]):
                key = song.get(number) or every.window(bpm, signal, number)
                if owner.setdefault(key, (signal.path, bpm)) == (signal.path, bpm):
                    song[number] = key
                wanted[ref.id].append(key)
        arrays, failed = self._compute_windows(songs)
        found: dict[str, tuple[AudioBlock, ...]] = {}
        for clip, keys in wanted.items():
            missing = [key for key in keys if key not in arrays]
            if missing:
                gathered.drop(clip, failed[owner[missing[0]][0]])
            else:
                found[clip] = tuple(AudioBlock(key, arrays[key]) for key in keys)
        return found

    def _compute_windows(
        self, songs: dict[tuple[Path, float | None], dict[int, str]]
    ) -> tuple[dict[str, CachedArray], dict[Path, Reject]]:
        """Return rows by key, and what failed by file."""
        gathered = self.gathered
        calls: list[tuple[Any, ...]] = []
        for (path, bpm), keys in songs.items():
            song = gathered.signals[path]
            calls += [(self.cache, gathered.recipe, self.feature, song, bpm, unit) for unit in window_units(keys)]
        known = [known_windows(self.cache, call[5]) for call in calls]
        arrays: dict[str, CachedArray] = {}
        failed: dict[Path, Reject] = {}
        for call, result in zip(calls, self._run(extract_windows, calls, known), strict=True):
            if isinstance(result, Reject):
                failed[call[3].path] = result
            else:
                arrays.update({call[5][number]: array for number, array in result.items()})
        return arrays, failed

    def _run(self, function: Any, calls: list[tuple[Any, ...]], known: list[Any]) -> list[Any]:
        """Run the units of work that are not known, each told which song comes next."""
        missing = [call[3] for call, result in zip(calls, known, strict=True) if result is None]
        ahead = iter(_next_songs(self.feature, missing))
        calls = [(*call, next(ahead)) if result is None else call for call, result in zip(calls, known, strict=True)]
        # Whoever has it all already need not look for cards.
        jobs = _jobs_for(self.feature, self.jobs) if missing else self.jobs
        return run_units(
            function,
            calls,
            known=known,
            jobs=jobs,
            label=self.feature.name,
            progress=self.progress,
            exact=self.feature.exact,
        )


def _jobs_for(feature: AudioFeature, jobs: Jobs) -> Jobs:
    """Return the workers for a feature: one that computes on cards wants one process a card."""
    return replace(jobs, n=feature.workers(jobs.n)) if isinstance(jobs, Workers) else feature.workers(jobs)


def _next_songs(feature: AudioFeature, songs: Sequence[SignalId]) -> list[Path | None]:
    """Return, for each unit of work, the file of the next one, if the feature computes on a device meanwhile."""
    if not feature.reads_ahead:
        return [None] * len(songs)
    paths: list[Path | None] = [song.path for song in songs]
    return [then if then != path else None for path, then in zip(paths, [*paths[1:], None], strict=False)]

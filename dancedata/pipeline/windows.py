"""Stage 3, encoded clips -> windowed clips: the windows that have motion, music and movement."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from types import MappingProxyType

import numpy as np

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.pipeline.audio import row_at, window_samples
from dancedata.pipeline.curation import Fault, without_faults
from dancedata.pipeline.encode import EncodedClip
from dancedata.pipeline.feature_files import starts_within
from dancedata.pipeline.groups import groups_of
from dancedata.pipeline.motion import MotionResult, motion_window_count
from dancedata.pipeline.rejects import short_audio, too_short
from dancedata.pipeline.sources import SourceClip
from dancedata.recipes.recipe import Recipe


@dataclass(frozen=True)
class WindowedClip:
    """A clip with the first frames of its windows, at the recipe's rate."""

    source: SourceClip
    motion: MotionResult
    starts: tuple[int, ...]


def cut_windows(
    recipe: Recipe, clips: Sequence[EncodedClip], faults: Mapping[str, Collection[Fault]] = MappingProxyType({})
) -> tuple[list[WindowedClip], list[Reject]]:
    """Cut clips into windows. Windows without music, with faults, or that the filter leaves out, become rejects."""
    cut: dict[str, tuple[int, ...]] = {}
    rejects = []
    for clip in clips:
        ref = clip.source.ref
        signal, motion = clip.source.signal, clip.motion
        music = None if signal is None else (signal.n_samples, signal.sample_rate)
        starts, problems = window_starts(recipe, ref, motion.n_source, motion.source_rate, music)
        rejects += problems
        of_motion = clip.motion.n_source, clip.motion.source_rate
        cut[ref.id], problems = starts_within(recipe, ref, clip.source.files, starts, of_motion)
        rejects += problems
        of_clip = faults.get(ref.id, ())
        cut[ref.id], problems = without_faults(recipe, ref, of_clip, cut[ref.id], motion.source_rate)
        rejects += problems
    left = [clip for clip in clips if cut[clip.source.ref.id]]
    groups = groups_of(left, lambda clip: clip.source.ref)
    for members in groups.values():
        rejects += _in_common(cut, [clip.source.ref.id for clip in members])
    filtered: dict[str, list[Reject]] = {}
    for clip in left:
        ref = clip.source.ref
        cut[ref.id], filtered[ref.id] = _filtered(recipe, ref, clip.motion, cut[ref.id])
    for members in groups.values():
        # A window goes only if the filter rejects it for every dancer: one who stands still is choreography.
        ids = [clip.source.ref.id for clip in members]
        kept = {start for clip_id in ids for start in cut[clip_id]}
        for clip_id in ids if kept else ():
            cut[clip_id] = tuple(sorted(kept))
            filtered[clip_id] = [r for r in filtered[clip_id] if r.window is not None and r.window not in kept]
    windowed = []
    for clip in left:
        rejects += filtered[clip.source.ref.id]
        if cut[clip.source.ref.id]:
            windowed.append(WindowedClip(clip.source, clip.motion, cut[clip.source.ref.id]))
    return windowed, rejects


def _in_common(cut: dict[str, tuple[int, ...]], ids: Sequence[str]) -> list[Reject]:
    """Keep the windows that all dancers of a group have, and return a reject for each of the others."""
    common = set.intersection(*(set(cut[clip]) for clip in ids))
    rejects = []
    for clip in ids:
        rejects += [
            Reject(
                "no_audio", clip, "", start, f"the window at frame {start}: the files of a partner do not reach it"
            )
            for start in cut[clip]
            if start not in common
        ]
        cut[clip] = tuple(start for start in cut[clip] if start in common)
        if not common:
            rejects.append(
                Reject("short_feature", clip, detail="no window lies within the files of all its partners")
            )
    return rejects


def _filtered(
    recipe: Recipe, ref: ClipRef, motion: MotionResult, starts: tuple[int, ...]
) -> tuple[tuple[int, ...], list[Reject]]:
    """Split a clip's window starts into those that the recipe's filter keeps and a reject for each of the others.

    If it keeps none, the last reject is that of the clip. Without a filter for the clip's split, all are kept.
    """
    chosen = recipe.filter
    if chosen is None or ref.split not in chosen.splits or not starts:
        return starts, []
    rows = np.asarray(motion.arrays[chosen.field])
    field = next(clip_field for clip_field in recipe.clip_fields if clip_field.name == chosen.field)
    length = recipe.grid.rows(recipe.windows.length, of=field.grid)
    kept, rejects = [], []
    for start in starts:
        if recipe.scope == "window":
            window = rows[recipe.windows.number(start)]
        else:
            first = recipe.grid.rows(start, of=field.grid)
            window = rows[first : first + length]
        window.flags.writeable = False
        reject = chosen.reject(window, field.columns, field.grid)
        if reject is None:
            kept.append(start)
        else:
            rejects.append(replace(reject, clip=ref.id, window=start))
    if not kept:
        detail = f"none of the {len(starts)} windows of clip {ref.id} passes the {chosen.name} filter"
        rejects.append(Reject(chosen.reason, ref.id, str(ref.motion_path), detail=detail))
    return tuple(kept), rejects


def audio_window_count(recipe: Recipe, n_samples: int, sample_rate: int) -> int:
    """Return the number of windows of a signal: whole windows of samples, or of all features' rows (track scope)."""
    if recipe.scope == "window":
        return len(window_samples(recipe.signal_jobs[0], n_samples, sample_rate)[0])
    counts = []
    for job in recipe.signal_jobs:
        rows = job.feature.n_rows(n_samples, sample_rate, job.grid)
        counts.append(recipe.windows.count(job.grid.rows_down(rows, of=recipe.grid)))
    return min(counts)


def window_starts(
    recipe: Recipe, ref: ClipRef, n_source: int, source_rate: Fraction, music: tuple[int, int] | None
) -> tuple[tuple[int, ...], list[Reject]]:
    """Return the window starts of a clip; windows without music become rejects.

    A clip without any window is left out: "too_short" if its motion is, "short_audio" if its music is. `music` is
    the number of samples and their rate; None where no feature needs music.
    """
    count = motion_window_count(recipe, n_source, source_rate)
    if not count:
        return (), [too_short(recipe, ref, n_source, source_rate)]
    n_frames = FrameGrid(source_rate).resampled_length(n_source, recipe.grid)
    rejects = _short_fields(recipe, ref, n_frames, count)
    if music is None:
        return tuple(recipe.windows.starts(count)), rejects
    path = ref.audio_path or ref.motion_path
    numbers = {"audio_s": round(music[0] / music[1], 3)}
    if ref.audio_start:
        starts, why = _starts_beside(recipe, ref, n_frames, count, *music)
    else:
        starts = [*recipe.windows.starts(min(count, audio_window_count(recipe, *music)))]
        why = f"reaches beyond the end of {path.name}"
    if not starts:
        return (), [*rejects, short_audio(recipe, ref, path, numbers["audio_s"])]
    with_music = set(starts)
    for k, start in enumerate(recipe.windows.starts(count)):
        if start not in with_music:
            rejects.append(Reject("no_audio", ref.id, "", start, f"window {k} {why}", {**numbers}))
    return tuple(starts), rejects


def _starts_beside(
    recipe: Recipe, ref: ClipRef, n_frames: int, count: int, n_samples: int, sample_rate: int
) -> tuple[list[int], str]:
    """Return the starts of windows that lie within music which does not begin with the clip, and where others lie."""
    if recipe.scope == "window":
        raise UsageError("music that does not begin with its clip needs scope: track", where=f"clip {ref.id}",
                         found=f"frame 0 at {float(ref.audio_start):g} s of the music",
                         fix="build with scope: track")  # fmt: skip
    first, end = 0, n_frames
    for job in recipe.signal_jobs:
        offset, skipped = row_at(ref.audio_start, sample_rate, job.grid)
        rows = job.feature.n_rows(max(n_samples - skipped, 0), sample_rate, job.grid)
        first = max(first, job.grid.rows_up(-offset, of=recipe.grid))
        end = min(end, job.grid.rows_down(rows - offset, of=recipe.grid))
    length, name = recipe.windows.length, (ref.audio_path or ref.motion_path).name
    starts = [start for start in recipe.windows.starts(count) if start >= first and start + length <= end]
    return starts, f"is not within {name}, whose second {float(ref.audio_start):g} is frame 0"


def _short_fields(recipe: Recipe, ref: ClipRef, n_frames: int, count: int) -> list[Reject]:
    """Return rejects of the windows of the recipe's grid that a field of another rate does not reach."""
    if recipe.scope == "window":
        return []
    on_grid = recipe.windows.count(n_frames)
    rates = sorted({str(field.grid) for field in recipe.motion})
    detail = f"fields at {' and '.join(rates)} rows per second do not all reach the end of the window"
    return [
        Reject("short_field", ref.id, "", recipe.windows.start(k), f"{detail}, number {k}")
        for k in range(count, on_grid)
    ]

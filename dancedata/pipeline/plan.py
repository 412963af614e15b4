"""dancedata plan: the outcome of a build, from lengths alone; computes no feature, writes no dataset."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.quality import implausible_flags
from dancedata.core.text import counted, shown, size_text, table
from dancedata.execution.cache import Cache, default_cache, with_lost_entries
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units
from dancedata.pipeline.audio import row_at
from dancedata.pipeline.build import header_of
from dancedata.pipeline.describe import rate_text, windows_text
from dancedata.pipeline.feature_files import FeatureFile, length_of, place, starts_within
from dancedata.pipeline.groups import group_motions, groups_of, require_places, unusable_dancers, whole_groups
from dancedata.pipeline.plan_cached import Cached, cached_units, not_ready
from dancedata.pipeline.rejects import (
    attempt,
    describe_implausible,
    left_out_lines,
    missing_music,
    nothing_left,
    relative_to,
)
from dancedata.pipeline.rhythm import with_found_starts
from dancedata.pipeline.sources import scan_source
from dancedata.pipeline.windows import window_starts
from dancedata.recipes.copies import copies_per_clip, is_copied
from dancedata.recipes.recipe import Recipe
from dancedata.store.schema import sort_splits


@dataclass(frozen=True)
class Retimed:
    """A copy at another speed: frames at the recipe's rate, windows as of a `ClipPlan`, rows of audio, its music."""

    speed: Fraction
    n_frames: int
    n_windows: int
    n_without_music: int
    audio_rows: tuple[int, ...]
    music: str


@dataclass(frozen=True)
class ClipPlan:
    """The outcome of a clip: frames at the recipe's rate, windows, rows of audio; or its problems.

    `n_without_music`: Windows that would be left out because the music ends before they do.
    `retimed`: Frames, windows and rows of audio of each copy at another speed.
    `implausible`: Flags for an implausible unit of length.
    """

    ref: ClipRef
    n_frames: int = 0
    n_windows: int = 0
    n_without_music: int = 0
    audio_rows: tuple[int, ...] = ()
    retimed: tuple[Retimed, ...] = ()
    problems: tuple[Reject, ...] = ()
    implausible: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True)
class Plan:
    """The outcome of a build."""

    recipe: Recipe
    source: Path
    scan: Scan
    clips: tuple[ClipPlan, ...]
    cached: Mapping[str, Cached]

    def __repr__(self) -> str:
        windows = sum(c.n_windows for c in self.clips)
        return f"Plan({self.recipe.name!r}, {sum(c.n_windows > 0 for c in self.clips)} clips, {windows} windows)"

    @property
    def rejects(self) -> list[Reject]:
        """Files and clips that would be left out, paths below the source; windows are only counted."""
        rejects = [*self.scan.rejects, *(problem for c in self.clips for problem in c.problems)]
        return [relative_to(reject, self.source) for reject in rejects]

    def require_clips(self) -> None:
        """Raise StoreError, as a build would, if nothing is left to store."""
        if not any(c.n_windows for c in self.clips):
            raise nothing_left(self.source, self.recipe.dataset, self.scan, self.rejects)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data: counts, columns and bytes."""
        kept = [c for c in self.clips if c.n_windows]
        left_out = Counter(r.reason for r in self.rejects)
        left_out.update({"no_audio": self._n_without_music})
        splits = {}
        for split in sort_splits({c.ref.split for c in kept}):
            of_split = [c for c in kept if c.ref.split == split]
            copies = self._copies(split)
            retimed = [copy for c in of_split for copy in c.retimed]
            splits[split] = {
                "clips": len(of_split) * copies + len(retimed),
                "windows": sum(c.n_windows for c in of_split) * copies + sum(c.n_windows for c in retimed),
                "frames": sum(c.n_frames for c in of_split) * copies + sum(c.n_frames for c in retimed),
                "songs": len({c.ref.music for c in of_split if c.ref.music}),
            }
        fields = {f.name: {"columns": f.columns.width, "dtype": f.dtype} for f in header_of(self.recipe, {}).fields}
        cached = {name: units.to_json() for name, units in self.cached.items()}
        return {
            "recipe": self.recipe.document,
            "recipe_sha256": self.recipe.sha256,
            "layout": self.scan.layout,
            "notes": [*self.scan.notes, *self._notes()],
            "splits": splits,
            "fields": fields,
            "cached": cached,
            "bytes": self._bytes(kept),
            "left_out": {reason: n for reason, n in sorted(left_out.items()) if n},
        }

    @property
    def summary(self) -> str:
        """The text that the command line prints."""
        return self.describe()

    def describe(self, out: Path | None = None) -> str:
        """Return the plan as text; `out` is named in its first line."""
        document = self.to_json()
        windows = windows_text(self.recipe.windows.length, self.recipe.windows.stride)
        into = "" if out is None else f" into {shown(out)}"
        lines = [
            f"{self.recipe.name}{into}: about {size_text(document['bytes'])}",
            rate_text(str(self.recipe.grid), windows),
            *table(
                ["split", "clips", "windows", "frames", "songs"],
                [[s, n["clips"], n["windows"], n["frames"], n["songs"]] for s, n in document["splits"].items()],
            ),
        ]
        for name, field in document["fields"].items():
            held = self.cached[name]
            cached = f"in the cache: {held.cached} of {held.of} {held.unit}"
            lines.append(f"  {name}: {field['columns']} columns, {field['dtype']}; {cached}")
        lines += [line if line.startswith(" ") else f"  would leave out: {line}" for line in self._left_out()]
        return "\n".join([*lines, *(f"  note: {note}" for note in document["notes"])])

    @property
    def _n_without_music(self) -> int:
        return sum(c.n_without_music + sum(copy.n_without_music for copy in c.retimed) for c in self.clips)

    def _left_out(self) -> list[str]:
        windows = self._n_without_music
        lines = left_out_lines(self.rejects)
        lines = [line.replace("  ", "    ", 1) if line.startswith(" ") else line for line in lines]
        return [*lines, f"no_audio: {counted(windows, 'window')}"] if windows else lines

    def _copies(self, split: str) -> int:
        return copies_per_clip(self.recipe.augment, split)

    def _notes(self) -> list[str]:
        notes = [line.strip() for line in describe_implausible(row for c in self.clips for row in c.implausible)]
        chosen = self.recipe.filter
        if chosen is not None:
            where = ", ".join(chosen.splits)
            notes.append(
                f"windows of {where} are counted before the {chosen.name} filter, which reads encoded motion"
            )
        curation = self.recipe.curation
        if curation.rules:
            scores = ", ".join(rule.score for rule in curation.rules)
            notes.append(f"clips and windows are counted before curate ({scores}), which reads motion")
        # A note: where a cluster builds, the weights need not be on the node that plans.
        return notes + [f"a build here ends with: {why}" for why in map(not_ready, self.recipe.audio) if why]

    def _bytes(self, kept: list[ClipPlan]) -> int:
        """Estimate the size of the shards, tables aside; equal windows of several files are counted each."""
        length = self.recipe.windows.length
        by_window = self.recipe.scope == "window"
        total = 0
        retimed = [(c, copy) for c in kept for copy in c.retimed]
        for field in header_of(self.recipe, {}).fields:
            if field.per_clip:
                frames = sum(
                    (c.n_windows * length if by_window else c.n_frames) * self._copies(c.ref.split) for c in kept
                )
                frames += sum(c.n_windows * length if by_window else c.n_frames for _, c in retimed)
                rows = self.recipe.grid.rows_up(frames, of=field.grid)
            else:
                index = [f.name for f in self.recipe.audio].index(field.name)
                clips: list[tuple[str, Path | None, str, ClipPlan | Retimed]] = []
                path_of = {c.ref.id: dict(c.ref.feature_paths).get(field.name, c.ref.audio_path) for c in kept}
                clips += [(c.ref.split, path_of[c.ref.id], "", c) for c in kept]
                clips += [(c.ref.split, c.ref.audio_path, copy.music, copy) for c, copy in retimed]
                songs = {(split, path, music): c.audio_rows[index] for split, path, music, c in clips}
                windows = dict.fromkeys(songs, 0)
                for split, path, music, c in clips:
                    windows[split, path, music] = max(windows[split, path, music], c.n_windows * length)
                rows = sum(songs.values())
                if by_window:
                    rows = sum(self.recipe.grid.rows_up(n, of=field.grid) for n in windows.values())
            total += rows * field.row_bytes
        return total


def make_plan(
    recipe: Recipe, source: Path, *, jobs: int = 1, cache: Path | None = None, progress: Progress | None = None
) -> Plan:
    """Plan a build of a source, and look up its units of work in the cache."""
    source = source.absolute()  # as in a build, so that messages are the same
    progress = progress or Progress(quiet=True)
    store_cache = Cache((cache or default_cache()).absolute())
    scanned = scan_source(recipe, source)
    scan = with_lost_entries(
        store_cache,
        lambda cache: with_found_starts(cache, recipe.dataset, scanned, jobs=jobs, progress=progress),
        progress,
    )
    songs: dict[Path | None, Any] = {}
    if recipe.signal_jobs:
        paths = sorted({ref.audio_path for ref in scan.clips if ref.audio_path is not None})
        lengths = run_units(
            _length, [(path,) for path in paths], jobs=jobs, label="lengths of music", progress=progress
        )
        songs.update(zip(paths, lengths, strict=True))
    groups = groups_of(scan.clips, lambda ref: ref)
    if groups:
        require_places(recipe)
    decodes = bool(recipe.signal_jobs)
    units = [[ref] for ref in scan.clips if not ref.group] + list(groups.values())
    calls = [
        (recipe, [(ref, songs.get(ref.audio_path, missing_music(ref)) if decodes else None) for ref in unit])
        for unit in units
    ]
    planned = run_units(_unit_plans, calls, jobs=jobs, label="lengths of motion", progress=progress)
    clips = _with_whole_groups(recipe, scan, {clip.ref.id: clip for of_unit in planned for clip in of_unit})
    kept = [(clip.ref, clip.n_windows) for clip in clips if clip.n_windows]
    retimed = [(clip.ref, copy.n_windows, copy.speed) for clip in clips for copy in clip.retimed]
    cached = cached_units(store_cache, recipe, scan.clips, kept, retimed)
    return Plan(recipe, source, scan, tuple(clips), cached)


#: A clip's music: samples and sample rate, a reject, or None without features.
_Music = tuple[int, int] | Reject | None


def _with_whole_groups(recipe: Recipe, scan: Scan, plans: Mapping[str, ClipPlan]) -> list[ClipPlan]:
    """Return the plans in the scan's order, without the dancers of groups that a build sets aside."""
    with_windows = [plan for plan in plans.values() if plan.n_windows]
    _, incomplete = whole_groups(recipe, with_windows, scan.clips, lambda plan: plan.ref)
    aside = {reject.clip: (reject,) for reject in incomplete}
    clips = [plans[ref.id] for ref in scan.clips]
    return [ClipPlan(c.ref, problems=aside[c.ref.id]) if c.ref.id in aside else c for c in clips]


def _unit_plans(recipe: Recipe, unit: Sequence[tuple[ClipRef, _Music]]) -> list[ClipPlan]:
    """Plan a single dancer, or those of a group."""
    # Motion and music are both examined, as in a build, so that all problems are named.
    motions = _motions(recipe, [ref for ref, _ in unit])
    return [_clip_plan(recipe, *of_clip, motion) for of_clip, motion in zip(unit, motions, strict=True)]


def _motions(recipe: Recipe, refs: Sequence[ClipRef]) -> Sequence[Motion | Reject]:
    """Load a single dancer, or those of a group, which are cut to one length; as in a build."""
    if not refs[0].group:
        return [attempt(lambda: recipe.dataset.load(refs[0]), refs[0].motion_path)]
    motions = attempt(lambda: group_motions(recipe, refs), refs[0].motion_path)
    if not isinstance(motions, Reject):
        return motions
    unusable = unusable_dancers(recipe, refs)
    if not unusable or len(unusable) == len(refs):
        return [motions] * len(refs)
    others = iter(_motions(recipe, [ref for k, ref in enumerate(refs) if k not in unusable]))
    return [unusable[k] if k in unusable else next(others) for k in range(len(refs))]


def _clip_plan(recipe: Recipe, ref: ClipRef, samples: _Music, motion: Motion | Reject) -> ClipPlan:
    """Plan a clip."""
    lengths = {job.name: length_of(job, ref) for job in recipe.file_jobs}
    files = {name: file for name, file in lengths.items() if isinstance(file, FeatureFile)}
    results = (motion, samples, *lengths.values())
    problems = tuple(replace(reject, clip=ref.id) for reject in results if isinstance(reject, Reject))
    if isinstance(motion, Reject) or isinstance(samples, Reject) or problems:
        return ClipPlan(ref, problems=problems)
    implausible = tuple({"clip": ref.id, **flag.to_json()} for flag in implausible_flags(motion))
    n_frames = motion.grid.resampled_length(motion.n_frames, recipe.grid)
    starts, left_out = window_starts(recipe, ref, motion.n_frames, motion.grid.rate, samples)
    starts, beyond = starts_within(recipe, ref, files, starts, (motion.n_frames, motion.grid.rate))
    left_out = [*left_out, *beyond]
    if not starts:
        return ClipPlan(ref, n_frames, problems=tuple(reject for reject in left_out if reject.window is None))
    without_music = sum(reject.reason == "no_audio" for reject in left_out)
    retimed = _retimed(recipe, ref, motion, samples) if is_copied(ref.split) else ()
    rows = _audio_rows(recipe, ref, ref.audio_start, samples, files)
    return ClipPlan(ref, n_frames, len(starts), without_music, rows, retimed, implausible=implausible)


def _audio_rows(
    recipe: Recipe,
    ref: ClipRef,
    start: Fraction,
    samples: tuple[int, int] | None,
    files: Mapping[str, FeatureFile] = MappingProxyType({}),
) -> tuple[int, ...]:
    """Return the rows of each audio field, of a file or of a song where a clip begins at second `start` of it."""
    rows = []
    for job in recipe.audio:
        if job.feature.from_files or samples is None:
            rows.append(place(job, ref, files[job.name].n_rows).n_rows if job.name in files else 0)
        else:
            skipped = row_at(start, samples[1], job.grid)[1]
            rows.append(job.feature.n_rows(max(samples[0] - skipped, 0), samples[1], job.grid))
    return tuple(rows)


def _retimed(recipe: Recipe, ref: ClipRef, motion: Motion, samples: tuple[int, int] | None) -> tuple[Retimed, ...]:
    """Plan the copies of a clip at other speeds; those without a window are left out."""
    copies = []
    for spec in recipe.augment:
        if spec.augmentation.changes != "time":
            continue
        unit = ref.group or ref.id
        speed = spec.speed_of(unit)
        grid = FrameGrid(motion.grid.rate * speed)
        stretched, start = None, ref.audio_start / speed
        if samples is not None:
            from dancedata.audio.stretch import stretched_length

            stretched = stretched_length(samples[0], speed), samples[1]
        copied = replace(ref, audio_start=start)
        starts, left_out = window_starts(recipe, copied, motion.n_frames, grid.rate, stretched)
        if starts:
            n_frames = grid.resampled_length(motion.n_frames, recipe.grid)
            rows = _audio_rows(recipe, ref, start, stretched)
            without_music = sum(reject.reason == "no_audio" for reject in left_out)
            copies.append(Retimed(speed, n_frames, len(starts), without_music, rows, spec.music_of(ref.music, unit)))
    return tuple(copies)


def _length(path: Path) -> tuple[int, int] | Reject:
    """Return samples and sample rate of a file, or its reject."""
    from dancedata.audio.signal import audio_length

    return attempt(lambda: audio_length(path), path)

"""dancedata evaluate: from a request to a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dancedata.core.clip import Reject
from dancedata.core.errors import DataError, UsageError
from dancedata.core.text import counted, listed
from dancedata.core.version import __version__
from dancedata.evaluation.clip_music import ClipMusic
from dancedata.evaluation.inputs.clip import ClipInput
from dancedata.evaluation.measuring import MeasuredClip, measure_clips
from dancedata.evaluation.music import about_windows, named_songs, stored_beats
from dancedata.evaluation.pool import Pool, check_target, load_pool, one_rate, pool_of, save_pool
from dancedata.evaluation.protocol import Protocol
from dancedata.evaluation.report import Report, lengths_of, per_clip_rows
from dancedata.evaluation.request import Request, Side
from dancedata.evaluation.scores import Score, rows_of, scores_of
from dancedata.evaluation.song_beats import song_beats
from dancedata.execution.cache import Cache, default_cache, package_version, with_lost_entries
from dancedata.execution.executors.base import Executor
from dancedata.execution.executors.loky import LokyExecutor
from dancedata.execution.progress import Progress
from dancedata.execution.units import check_backend, start_workers

__all__ = ["evaluate", "pool_for", "report_of"]

#: Music that ends so much before the motion, seconds, is not told.
_TOLERANCE_S = 0.1


def evaluate(
    request: Request,
    *,
    save: Path | None = None,
    jobs: int = 1,
    cache: Path | None = None,
    backend: str = "loky",
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Report:
    """Measure the set and the pool of a request, and compare them.

    Parameters
    ----------
    save
        File to write the pool to.
    jobs, cache, backend, scheduler
        As in a build; the result does not depend on them.

    Raises
    ------
    UsageError
        If the protocol cannot be computed from this motion, rates are mixed, or the pool is another protocol's.
    StoreError
        If a dataset has other bytes than the build wrote.
    """
    check_backend(backend, scheduler)
    progress = progress or Progress(quiet=True)
    root = Cache((cache or default_cache()).absolute())
    numbers = request.numbers
    if save is not None:
        check_target(save, request.protocol)
    side = request.set_side()
    packages = {"numpy", "scipy"}
    with start_workers(jobs, root, _folder(side), packages, backend=backend, scheduler=scheduler) as workers:
        report = with_lost_entries(
            root, lambda kept: _Run(kept, request, workers, progress).report(side, numbers, save), progress
        )
    return report


def pool_for(request: Request, *, jobs: int = 1, cache: Path | None = None) -> Pool | None:
    """Measure or read the pool of a request; None if its protocol needs none, or there is none."""
    root = Cache((cache or default_cache()).absolute())
    quiet, numbers = Progress(quiet=True), request.numbers
    return with_lost_entries(root, lambda kept: _Run(kept, request, LokyExecutor(jobs), quiet).pool(numbers), quiet)


@dataclass(frozen=True)
class _Run:
    """One evaluation with its workers."""

    cache: Cache
    request: Request
    workers: Executor
    progress: Progress

    def report(self, side: Side, numbers: Sequence[int], save: Path | None) -> Report:
        protocol = self.request.protocol
        pool = self.pool(range(len(protocol.measures)) if save is not None else numbers)
        if save is not None:
            if pool is None:
                raise UsageError("no pool was given, so none can be saved", fix="name a dataset: --pool STORE")
            save_pool(save, protocol, pool)
        clips = named_songs(side.clips, self.request.songs, self.request.like or side.store)
        needs_music = any(protocol.measures[number].metric.needs_music for number in numbers)
        music, problems = self._music(replace(side, clips=clips)) if needs_music else ({}, [])
        measured, rejects = self._measure(clips, side, numbers, music)
        if needs_music and not any(m.fps for m in measured):
            raise UsageError("no clip could be measured", where=side.source, found="; ".join(problems))
        report = report_of(
            protocol, measured, pool, role=side.role, source=side.source, draws=self.request.draws, numbers=numbers
        )
        warnings = (*problems, *_short_music(measured, music), *report.warnings)
        left_out = tuple((r.clip, r.detail) for r in rejects)
        return replace(report, warnings=warnings, left_out=left_out)

    def _measure(
        self, clips: Sequence[ClipInput], side: Side, numbers: Sequence[int], music: Mapping[str, ClipMusic]
    ) -> tuple[list[MeasuredClip], list[Reject]]:
        if side.store is not None:
            side.store.require_intact({clip.clip for clip in clips}, sha256=self.cache.file_sha256)
        measured, rejects = measure_clips(
            self.cache, self.request.protocol, side.role, numbers, clips, music, jobs=self.workers,
            progress=self.progress,
        )  # fmt: skip
        if not measured and rejects:
            raise DataError(
                "no clip can be measured", reason="nothing_left", where=side.source, found=rejects[0].detail
            )
        return measured, rejects

    def pool(self, asked: Sequence[int]) -> Pool | None:
        protocol = self.request.protocol
        numbers = [n for n in asked if protocol.measures[n].metric.needs_pool]
        given = self.request.pool
        if isinstance(given, str | Path) and Path(given).suffix == ".npz":
            read = load_pool(Path(given).expanduser(), protocol)
            read.require(protocol, read.fps, self.request.scaler_sha256)
            return read
        side = self.request.pool_side() if numbers else None
        if side is None:
            return None
        measured, _ = self._measure(side.clips, side, numbers, {})
        pool = pool_of(protocol, measured, side.source)
        return pool if side.store is not None else replace(pool, scaler=self.request.scaler_sha256)

    def _music(self, side: Side) -> tuple[dict[str, ClipMusic], list[str]]:
        """Return beats by clip: given ones, those of music files, then those of stores; and problems in words."""
        request, rule = self.request, self.request.protocol.music
        if rule is None:
            return {}, []
        found = {clip: ClipMusic(beats) for clip, beats in request.given_beats(side.clips).items()}
        problems: list[str] = []
        files = request.music_files()
        if files:
            left = [clip for clip in side.clips if clip.id not in found]
            computed, problems = song_beats(
                self.cache, request.protocol, side.role, left, files, jobs=self.workers, progress=self.progress
            )
            found |= computed
        for store in (side.store, request.like):
            left = [clip for clip in side.clips if clip.id not in found]
            if store is not None and left:
                pieces = request.protocol.pieces(side.role)
                stored = stored_beats(store, rule, pieces, left, request.songs, self.cache.file_sha256)
                problems += about_windows(store, rule) if stored else []
                found |= stored
        unheard = sorted({clip.music for clip in side.clips if clip.id in request.songs and clip.id not in found})
        if unheard and not files:
            problems.append(f"no beats of songs that --music-of names: {listed(unheard)}")
        if not found:
            problems.append(_no_music(request.protocol))
        return found, problems


def report_of(
    protocol: Protocol,
    measured: Sequence[MeasuredClip],
    pool: Pool | None,
    *,
    role: str,
    source: str,
    draws: int = 200,
    numbers: Sequence[int] | None = None,
) -> Report:
    """Compare measured clips with a pool.

    Parameters
    ----------
    draws
        How many times scores are computed again for intervals, at most; 0: no intervals.
    numbers
        Which of the protocol's measures; None: all.

    Raises
    ------
    UsageError
        If rates are mixed, or the pool is of another protocol, version or rate.
    """
    ordered = sorted(measured, key=lambda m: m.id)
    fps = one_rate(ordered, source)
    if pool is not None:
        pool.require(protocol, fps)
    scores: list[Score] = []
    warnings: list[str] = []
    for number in range(len(protocol.measures)) if numbers is None else numbers:
        metric = protocol.measures[number].metric
        found = rows_of(ordered, number, metric)
        vectors = None if pool is None else pool.rows.get(number)
        own, about = scores_of(metric, found, vectors, draws=draws)
        scores += own
        warnings += about
    published = {
        name: value for p in protocol.published if p.what == "ground truth" for name, value in p.values.items()
    }
    scores = [replace(score, published=published.get(score.name)) for score in scores]
    changed = sorted({note for m in ordered for note in m.notes})
    return Report(
        protocol=protocol,
        role=role,
        source=source,
        scores=tuple(scores),
        clips=tuple(m.id for m in ordered),
        pieces=sum(len(m.cuts) for m in ordered),
        fps=fps,
        seconds=lengths_of([s for m in ordered for s in m.seconds]),
        pool=None if pool is None else pool.to_json(),
        left_out=(),
        warnings=tuple(dict.fromkeys(warnings)),
        notes=(*changed, *protocol.notes),
        per_clip=tuple(per_clip_rows(protocol, ordered)),
        versions={"dancedata": __version__, **{name: package_version(name) for name in ("numpy", "scipy")}},
    )


def _no_music(protocol: Protocol) -> str:
    rule = protocol.music
    if rule is None:
        return ""
    rate = f" at {rule.fps} per second" if rule.fps else ""
    scope = ", each piece by itself" if rule.scope == "window" else ""
    about = f" ({rule.about})" if rule.about else ""
    return (
        f"no beats of music: the protocol takes those of {' or '.join(rule.features)}{rate}{scope}{about}; give "
        "--source MUSIC or a dataset with that field (--like), and --music-of FILE.csv for clips whose ids are not "
        "those of songs or of clips of the dataset"
    )


def _short_music(measured: Sequence[MeasuredClip], music: Mapping[str, ClipMusic]) -> list[str]:
    """Warn of clips whose music ends before their motion."""
    short = []
    for m in measured:
        end = music[m.id].end_s if m.id in music else None
        if end is not None and m.end_s > end + _TOLERANCE_S:
            short.append(m.id)
    return [f"the music ends before the motion of {counted(len(short), 'clip')}: {listed(short)}"] if short else []


def _folder(side: Side) -> Path:
    """Return a folder that workers of a cluster have to see."""
    for clip in side.clips:
        path = getattr(clip, "path", None) or getattr(clip, "motion_path", None)
        if isinstance(path, Path):
            return path if path.is_dir() else path.parent
    return Path.cwd()

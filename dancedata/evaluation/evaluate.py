"""dancedata evaluate: from a request to a report."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dancedata.core.errors import UsageError
from dancedata.core.text import counted, listed
from dancedata.core.version import __version__
from dancedata.evaluation.clip_music import ClipMusic
from dancedata.evaluation.inputs.clip import ClipSet
from dancedata.evaluation.measuring import MeasuredClip, Resources, measure_clips
from dancedata.evaluation.music import clip_music
from dancedata.evaluation.pool import Pool, check_target, one_rate, pool_of, save_pool
from dancedata.evaluation.protocol import Protocol
from dancedata.evaluation.report import Report, lengths_of, per_clip_rows
from dancedata.evaluation.request import Inputs, Request
from dancedata.evaluation.scores import Score, rows_of, scores_of
from dancedata.execution.cache import Cache, default_cache, package_version, with_lost_entries
from dancedata.execution.executors.loky import LokyExecutor
from dancedata.execution.progress import Progress
from dancedata.execution.units import check_backend, start_workers

#: Tolerance in seconds before warning about short music.
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
        If the bytes of a dataset differ from what the build wrote.
    """
    check_backend(backend, scheduler)
    if save is not None:
        check_target(save, request.protocol)
    inputs = request.inputs(whole_pool=save is not None)
    if save is not None and inputs.pool is None:
        raise UsageError("no pool was given, so none can be saved", fix="name a dataset: --pool STORE")
    return evaluate_inputs(
        inputs, save=save, jobs=jobs, cache=cache, backend=backend, scheduler=scheduler, progress=progress
    )


def evaluate_inputs(
    inputs: Inputs,
    *,
    save: Path | None = None,
    jobs: int = 1,
    cache: Path | None = None,
    backend: str = "loky",
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Report:
    """Measure inputs, and compare them; see `evaluate`."""
    progress = progress or Progress(quiet=True)
    root = Cache((cache or default_cache()).absolute())
    folder = inputs.clip_set.folder
    with start_workers(jobs, root, folder, {"numpy", "scipy"}, backend=backend, scheduler=scheduler) as workers:
        return with_lost_entries(
            root, lambda cache: _report(Resources(cache, workers, progress), inputs, save), progress
        )


def _report(resources: Resources, inputs: Inputs, save: Path | None) -> Report:
    protocol, clip_set = inputs.protocol, inputs.clip_set
    pool = _measured_pool(resources, protocol, inputs.pool, inputs.pool_numbers, inputs.scaler_sha256)
    if save is not None and pool is not None:
        save_pool(save, protocol, pool)
    needs_music = any(protocol.measures[number].metric.needs_music for number in inputs.numbers)
    music, problems = clip_music(resources, protocol, clip_set, inputs.music) if needs_music else ({}, [])
    measured, rejects = measure_clips(resources, protocol, clip_set, inputs.numbers, music)
    if needs_music and not any(clip.fps for clip in measured):
        raise UsageError("no clip could be measured", where=clip_set.source, found="; ".join(problems))
    return report_of(
        protocol, measured, pool, role=clip_set.role, source=clip_set.source, draws=inputs.draws,
        numbers=inputs.numbers, left_out=[(reject.clip, reject.detail) for reject in rejects],
        warnings=[*problems, *_short_music(measured, music)],
    )  # fmt: skip


def pool_for(request: Request, *, jobs: int = 1, cache: Path | None = None) -> Pool | None:
    """Measure or read the pool of a request; None if its protocol needs none, or there is none."""
    root, progress = Cache((cache or default_cache()).absolute()), Progress(quiet=True)
    pool, numbers = request.pool_input()
    scaler = request.scaler_sha256 if isinstance(pool, ClipSet) else ""

    def measured(cache: Cache) -> Pool | None:
        resources = Resources(cache, LokyExecutor(jobs), progress)
        return _measured_pool(resources, request.protocol, pool, numbers, scaler)

    return with_lost_entries(root, measured, progress)


def _measured_pool(
    resources: Resources, protocol: Protocol, pool: ClipSet | Pool | None, numbers: Sequence[int], scaler: str
) -> Pool | None:
    if not isinstance(pool, ClipSet):
        return pool
    measured, _ = measure_clips(resources, protocol, pool, numbers, {})
    return pool_of(protocol, measured, pool.source, "" if pool.store is not None else scaler)


def report_of(
    protocol: Protocol,
    measured: Sequence[MeasuredClip],
    pool: Pool | None,
    *,
    role: str,
    source: str,
    draws: int = 200,
    numbers: Sequence[int] | None = None,
    left_out: Iterable[tuple[str, str]] = (),
    warnings: Iterable[str] = (),
) -> Report:
    """Compare measured clips with a pool.

    Parameters
    ----------
    draws
        How many times scores are computed again for intervals, at most; 0: no intervals.
    numbers
        Measures of the protocol; None: all.
    left_out
        Clips that could not be measured, with the reason.
    warnings
        Warnings that come first.

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
    of_scores: list[str] = []
    for number in range(len(protocol.measures)) if numbers is None else numbers:
        metric = protocol.measures[number].metric
        rows = rows_of(ordered, number, metric)
        of_metric, messages = scores_of(metric, rows, None if pool is None else pool.rows.get(number), draws=draws)
        scores += of_metric
        of_scores += messages
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
        left_out=tuple(left_out),
        warnings=(*warnings, *dict.fromkeys(of_scores)),
        notes=(*changed, *protocol.notes),
        per_clip=tuple(per_clip_rows(protocol, ordered)),
        versions={"dancedata": __version__, **{name: package_version(name) for name in ("numpy", "scipy")}},
    )


def _short_music(measured: Sequence[MeasuredClip], music: Mapping[str, ClipMusic]) -> list[str]:
    """Warn of clips whose music ends before their motion."""
    short = []
    for m in measured:
        end = music[m.id].end_s if m.id in music else None
        if end is not None and m.end_s > end + _TOLERANCE_S:
            short.append(m.id)
    return [f"the music ends before the motion of {counted(len(short), 'clip')}: {listed(short)}"] if short else []

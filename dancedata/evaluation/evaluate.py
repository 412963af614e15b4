"""From the inputs of an evaluation to its report."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dancedata.core.errors import UsageError
from dancedata.core.text import counted, listed
from dancedata.evaluation.clips import ClipSet
from dancedata.evaluation.measuring import MeasuredClip, MeasuredSet, measure_clips
from dancedata.evaluation.music import ClipMusic, MusicPlan, MusicPlans, Resources, read_beats
from dancedata.evaluation.options import EvaluationOptions, Inputs
from dancedata.evaluation.pool import Pool, pool_of
from dancedata.evaluation.protocol import Protocol
from dancedata.evaluation.report import Report, report_of
from dancedata.kernel import Cache, Executor, Progress, start_workers

#: Tolerance in seconds before warning about short music.
_TOLERANCE_S = 0.1


def evaluate_inputs(
    inputs: Inputs,
    music: MusicPlans,
    *,
    jobs: int = 1,
    cache: Path | None = None,
    backend: str | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Report:
    """Measure the set and the pool, and compare them; StoreError if a dataset was changed after its build."""
    progress = progress or Progress(quiet=True)
    root = Cache.at(cache)
    folder = inputs.clip_set.folder
    with start_workers(jobs, root, folder, {"numpy", "scipy"}, backend=backend, scheduler=scheduler) as workers:
        return root.retry_lost(lambda cache: _report(Resources(cache, workers, progress), inputs, music), progress)


def _report(resources: Resources, inputs: Inputs, music: MusicPlans) -> Report:
    protocol, clip_set, truth, numbers = inputs.protocol, inputs.clip_set, inputs.truth, inputs.numbers
    measured, beats, problems = _measured(resources, protocol, clip_set, numbers, music[0])
    if clip_set.nothing_matched is not None:
        raise clip_set.nothing_matched
    if music[0] is not None and not any(clip.fps for clip in measured.clips):
        raise UsageError("no clip could be measured", where=clip_set.source, found="; ".join(problems))
    of_truth: list[MeasuredClip] = []
    if truth is not None:
        of_truth = _measured(resources, protocol, truth, numbers, music[1])[0].clips
    pool = _pool(resources, protocol, inputs.pool, inputs.pool_numbers)
    report = report_of(
        protocol, measured.clips, pool, role=clip_set.role, source=clip_set.source, draws=inputs.draws,
        numbers=numbers, left_out=[*clip_set.left_out, *((r.clip, r.detail) for r in measured.rejects)],
        warnings=[*clip_set.warnings, *problems, *_short_music(measured.clips, beats)], matched=clip_set.matched,
        truth=of_truth, truth_source="" if truth is None else truth.source, in_pool=inputs.in_pool,
        dataset=inputs.dataset, cache=resources.cache,
    )  # fmt: skip
    return replace(report, inputs=clip_set.clips, music=beats)


def _measured(
    resources: Resources, protocol: Protocol, clip_set: ClipSet, numbers: Sequence[int], plan: MusicPlan | None
) -> tuple[MeasuredSet, dict[str, ClipMusic], list[str]]:
    """Read the beats of a set and measure its clips; return them with the beats, and problems of these in words."""
    beats, problems = read_beats(resources, plan)
    return measure_clips(resources, protocol, clip_set, numbers, beats), beats, problems


def _pool(
    resources: Resources, protocol: Protocol, pool: ClipSet | Pool | None, numbers: Sequence[int]
) -> Pool | None:
    """Return a pool that was read from a file, or measure its clips."""
    if not isinstance(pool, ClipSet):
        return pool
    measured, _, _ = _measured(resources, protocol, pool, numbers, None)
    return pool_of(protocol, measured.clips, pool.source, pool.scaler_sha256)


def pool_for(request: EvaluationOptions, root: Cache, *, jobs: int = 1) -> Pool | None:
    """Measure or read the pool of a request; None if its protocol needs none, or none exists."""
    progress = Progress(quiet=True)
    pool, numbers = request.pool_input()
    return root.retry_lost(
        lambda cache: _pool(Resources(cache, Executor(jobs), progress), request.protocol, pool, numbers), progress
    )


def _short_music(measured: Sequence[MeasuredClip], music: Mapping[str, ClipMusic]) -> list[str]:
    ends = {clip: of_clip.end_s for clip, of_clip in music.items()}
    short = [m.id for m in measured if (end := ends.get(m.id)) is not None and m.end_s > end + _TOLERANCE_S]
    return [f"the music ends before the motion of {counted(len(short), 'clip')}: {listed(short)}"] if short else []

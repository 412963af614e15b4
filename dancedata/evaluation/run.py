"""evaluate from Python: the function that `dancedata evaluate` calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy.typing as npt

from dancedata.core.arguments import folder_of
from dancedata.core.grid import Number
from dancedata.evaluation.evaluate import evaluate_inputs
from dancedata.evaluation.options import EvaluationOptions
from dancedata.evaluation.pool import save_pool as write_pool
from dancedata.evaluation.protocol import Protocol, protocol_named, with_metrics
from dancedata.evaluation.report import Report
from dancedata.kernel import Progress, Store, jobs_of, saved_samples
from dancedata.scene.inputs.songs import MusicLike, MusicSources
from dancedata.scene.like import DatasetLike, ScalerLike, opened, store_of

if TYPE_CHECKING:
    from dancedata.core.motion import Motion

__all__ = ["evaluate"]

#: A dataset, a folder or a file of motion, or motions by the id of a clip.
MotionSet: TypeAlias = "str | Path | Store | Mapping[str, npt.ArrayLike | Motion]"


def evaluate(
    what: MotionSet,
    *,
    protocol: str | Protocol = "dancedata",
    pool: MotionSet | None = None,
    split: str | None = None,
    pool_split: str | None = None,
    role: Literal["truth", "generated"] | None = None,
    like: DatasetLike = None,
    field: str | None = None,
    normalized: bool | None = None,
    scaler: ScalerLike = None,
    clamp: bool = False,
    fps: Number | None = None,
    up: str | None = None,
    unit: str | None = None,
    body: str | None = None,
    music: MusicLike = None,
    metrics: Sequence[str] = (),
    intervals: bool = True,
    save_pool: str | Path | None = None,
    jobs: int | None = 1,
    cache: str | Path | None = None,
    backend: str | None = None,
    scheduler: str | None = None,
    progress: bool = False,
) -> Report:
    """Evaluate motion under a named protocol, as ``dancedata evaluate`` does.

    Parameters
    ----------
    what
        A built dataset, a folder of generated motion, one file of it, or positions (T, J, 3) and motions by the id of
        a clip, metres, +Y up. What `WindowDataset.save_samples` wrote needs no further statement.
    protocol
        Name of a protocol, or an object of one.
    pool
        What the set is compared with: a dataset, a folder, or a file of `save_pool`. Default: the dataset that
        is evaluated, or that `like` names.
    split, pool_split
        Splits of a dataset: "test", "val,test" or "all". Default: test of the set, where the dataset has it, and the
        protocol's of the pool. Of samples with `like`, `split` chooses the real dances beside them.
    role
        "truth" or "generated", where a protocol cuts the two differently. Default: datasets are ground truth, all
        else is generated.
    like
        Dataset that a model was trained on, or its reader: its rate, columns, scaler, music, and by default the pool.
        A reader states its scaler, and whether it normalises.
    field
        What columns are: a motion field of the dataset, or of `like`; without one a representation. Default: what
        samples state, else the only field of their width, else the first one that has the protocol's joints.
    normalized
        Whether columns are normalised by the scaler of `like`. Where columns are read with a dataset as `like`, it
        has to be stated, here or by the entry ``normalized`` of their files; columns that are clearly not as stated
        are refused.
    scaler
        Another scaler, or the file of its ``save``: columns are normalised by it.
    clamp
        Whether normalised values are cut to [-1, 1] before, as EDGE and Lodge do.
    fps, up, unit, body
        Declarations for files that do not state them; `body` is the body of joint positions, such as "smpl24".
    music
        A music file, that of all clips; a folder of them, by the names of songs; a CSV file with the columns sample,
        song and start_s, the song's second at the first frame, which windows need. Or a mapping by the id of a clip:
        a song or its file, a pair of it and its second, or the beats, frames at the protocol's rate or `MusicBeats`.
        Default: that of the dataset, or of `like`.
    metrics
        Compute only these, by the names of metrics ("kinetic") or of scores ("fid_k"). Default: all of the protocol.
        Every registered metric may be named: one that is not of the protocol has its default parameters.
    intervals
        Whether scores have intervals of 95 percent; they are computed again up to 200 times for them.
    save_pool
        File (.npz) to write the pool to.
    jobs, cache, backend, scheduler, progress
        As in `build`. The result does not depend on `jobs`.

    Returns
    -------
    Report
        ``report["fid_k"]`` is a score with its verdict: ``float`` of one that means nothing is an error with the
        reason. ``str(report)`` is the table, ``report.numbers()`` for loggers, ``report.to_json()`` all of it.

    Raises
    ------
    UsageError
        If the protocol cannot be computed from this motion, clips have different rates, or the pool is of another
        protocol, version, rate or scaler; if nothing states whether columns are normalised, or they are not so.
    DataError
        If no clip can be measured.

    Examples
    --------
    >>> import dancedata
    >>> report = dancedata.evaluate("data/aistpp", split="val,test")
    >>> 0 < report["bas"].value < 1
    True
    """
    named, saved = None if like is None else opened(like), saved_samples(what)
    if saved is not None:
        of = saved.like(None if named is None else store_of(named))
        named, field = named or of, field or saved.field
        scaler = saved.chosen_scaler(scaler, normalized) if isinstance(named, Store) else scaler
    request = EvaluationOptions(
        what=what, protocol=with_metrics(protocol_named(protocol), metrics), pool=pool, split=split,
        pool_split=pool_split, role=role, like=None if named is None else store_of(named),
        reader=None if isinstance(named, Store) else named, field=field, normalized=normalized, scaler=scaler,
        clamp=clamp, fps=fps, up=up, unit=unit, body=body, music=MusicSources.of(music), metrics=tuple(metrics),
        intervals=intervals, save_pool=folder_of(save_pool),
    )  # fmt: skip
    inputs = request.inputs()
    report = evaluate_inputs(
        inputs, request.music_plans(inputs), jobs=jobs_of(jobs), cache=folder_of(cache), backend=backend,
        scheduler=scheduler, progress=Progress(quiet=not progress),
    )  # fmt: skip
    if request.save_pool is not None and report.pool is not None:
        write_pool(request.save_pool, report.protocol, report.pool)
    return report

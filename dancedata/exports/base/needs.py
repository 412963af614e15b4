"""The usual checks of exports: each returns the missing requirement, with the line of a recipe that gives it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from dancedata.core.errors import DanceDataError, did_you_mean
from dancedata.core.text import listed, quoted
from dancedata.exports.base.job import ExportJob, Missing

if TYPE_CHECKING:
    from dancedata.kernel import Clip

_SOURCE = "give --music DIR, the folder with the music"


def needs_field(
    job: ExportJob, name: str, *, kind: str, width: int | None = None, rate: int | str | None = None
) -> list[Missing]:
    """Check that a field is stored, with a width and a rate.

    `kind`: "motion", "audio" or "keymotion": the slot of the recipe.
    `width`, `rate`: Columns, and rows per second; None: any.
    """
    from dancedata.files.yaml import recipes_with

    line = f"{kind}: {{{name}: {{}}}}"
    if name not in job.store.fields:
        makers = recipes_with(name)
        shipped = f", as in the recipe {' or '.join(makers)}" if makers else ""
        problem = f"the dataset has no field {name} (it has {', '.join(job.store.fields)})"
        return [Missing(problem, f"{line}{shipped}")]
    field, problems = job.store.field(name), []
    if field.kind != kind:
        problems.append(Missing(f"{name} is a field of the kind {field.kind}, not {kind}", line))
    if width is not None and field.columns.width != width:
        problems.append(Missing(f"{name} has {field.columns.width} columns, not {width}", line))
    if rate is not None and field.rate != Fraction(rate):
        fix = f"{kind}: {{{name}: {{fps: {rate}}}}}" if kind == "audio" else f"fps: {rate}"
        problems.append(Missing(f"{name} has {field.rate} rows per second, not {rate}", fix))
    return problems


def needs_fields(job: ExportJob, names: Iterable[str]) -> list[Missing]:
    """Check that fields of any kind are stored."""
    fields = job.store.fields
    return [Missing(f"the dataset has no field {n!r}", did_you_mean(n, fields)) for n in names if n not in fields]


def needs_train(job: ExportJob, scaler: str, fitted: str) -> list[Missing]:
    """Check that there is a split train where a scaler is fitted on it alone."""
    lacks = scaler == "train" and "train" not in job.store.splits
    return [Missing(f"the dataset has no split train to fit {fitted} on", "--scaler all")] if lacks else []


def needs_fps(job: ExportJob, fps: int) -> list[Missing]:
    """Check the frame rate of the dataset."""
    missing = Missing(f"the dataset has {job.store.fps} frames per second, not {fps}", f"fps: {fps}")
    return [missing] if job.store.fps != fps else []


def needs_splits(job: ExportJob, *splits: str) -> list[Missing]:
    """Check that splits have clips."""
    absent = [split for split in splits if split not in job.store.splits]
    problem = f"the dataset has no clips in {' and '.join(absent)} (its splits: {', '.join(job.store.splits)})"
    fix = "a source with clips of them, a recipe with these splits, such as dataset: {aist++: {split: crossmodal}}"
    return [Missing(problem, fix)] if absent else []


def needs_music_from_start(clips: Sequence[Clip], *, exactly: bool = False) -> list[Missing]:
    """Check that music is there from each clip's first frame; with `exactly`, that its file begins there."""
    beside = [clip.id for clip in clips if (clip.audio_start if exactly else clip.audio_start < 0)]
    where = "elsewhere" if exactly else "later"
    problem = f"music has to begin with its motion, and that of {listed(beside)} begins {where}"
    return [Missing(problem, "a source whose music files begin with the motion")] if beside else []


def needs_music(job: ExportJob, clips: list[Clip]) -> list[Missing]:
    """Check that --music has the music of clips."""
    if job.music_folder is None:
        return [Missing("the music itself is needed, which no dataset holds", _SOURCE)]
    try:
        missing = job.music.missing(clips)
    except DanceDataError as error:
        return [Missing(str(error), _SOURCE)]
    stretched = [c.id for c in clips if c.source and c.n_frames != job.store[c.source].n_frames]
    if stretched:
        problem = f"copies at another tempo, whose music no source holds: {listed(stretched)}"
        return [Missing(problem, "a recipe without copies at another tempo under augment")]
    return [Missing(f"no music below {job.music_folder} for {listed(missing)}", _SOURCE)] if missing else []


def needs_names(clips: Iterable[Clip], is_read_right: Callable[[str], bool], form: str) -> list[Missing]:
    """Check that the loader does not misread the names of clips; `form` describes the names that it reads."""
    bad = [quoted(clip.id) for clip in clips if not is_read_right(clip.id)]
    return [Missing(f"names that the loader would read wrongly: {listed(bad)}", f"name clips {form}")] if bad else []

"""dancedata check --faults: the scores of faults in motions, in a folder to build from or in a built dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.arguments import Overrides, folder_of
from dancedata.core.clip import Reject
from dancedata.core.left_out import left_out_lines
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.rejects import relative_to
from dancedata.core.tables import csv_cell, table
from dancedata.core.text import counted, shown
from dancedata.curation.annotators import Faults
from dancedata.curation.scores import MEASURES, Score, score_motion
from dancedata.curation.spans import Span
from dancedata.files.addresses import local_folder
from dancedata.files.csv_report import csv_text, require_new_csv, write_csv
from dancedata.kernel import (
    DATASET_FILE,
    Cache,
    Progress,
    Recipe,
    RecipeLike,
    Store,
    annotate_clips,
    chosen_recipe,
    jobs_of,
    open_store,
    scan_folder,
)

_CSV = ("clip", "score", "value", "unit", "limit", "above", "start_s", "end_s", "span_value", "joint")
#: Clips and spans that the text shows.
_CLIPS, _SPANS = 20, 3


@dataclass(frozen=True)
class ClipQuality:
    """The scores of a clip, by name, and the rate of the frames of their spans."""

    clip: str
    rate: Fraction
    scores: Mapping[str, Score]

    def above(self, score: str, limit: float | None = None) -> bool:
        """Whether a score is above a limit, by default its own."""
        value = self.scores[score].value
        return value is not None and value > (MEASURES[score].limit if limit is None else limit)

    def seconds(self, span: Span) -> tuple[float, float]:
        """Return start and end of a span, seconds."""
        return float(span.start / self.rate), float(span.end / self.rate)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        scores = {}
        for name, score in self.scores.items():
            spans = [
                {"start_s": round(a, 4), "end_s": round(b, 4), "value": span.value, "joint": span.joint}
                for span in score.spans
                for a, b in [self.seconds(span)]
            ]
            scores[name] = {"value": score.value, "above": self.above(name), "spans": spans}
        return {"clip": self.clip, "rate": str(self.rate), "scores": scores}


@dataclass(frozen=True)
class Quality:
    """The scores of motions, those that could not be read, and the file that was written."""

    where: str
    clips: tuple[ClipQuality, ...]
    rejects: tuple[Reject, ...] = ()
    file: Path | None = None

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "where": self.where,
            "scores": {name: {**asdict(m), "above": self._n_above(name)} for name, m in MEASURES.items()},
            "clips": [clip.to_json() for clip in self.clips],
            "rejects": [reject.to_json() for reject in self.rejects],
            "file": None if self.file is None else str(self.file),
        }

    def to_csv(self) -> str:
        """Return a table with a line for each score of a clip, and one for each of its spans."""
        rows: list[list[object]] = []
        for clip in self.clips:
            for name, score in clip.scores.items():
                value = "" if score.value is None else score.value
                head = [csv_cell(clip.clip), name, value, MEASURES[name].unit, MEASURES[name].limit, clip.above(name)]
                rows.append([*head, "", "", "", ""])
                for span in score.spans:
                    places = [f"{second:.4f}" for second in clip.seconds(span)]
                    rows.append([*head, *places, span.value, csv_cell(span.joint)])
        return csv_text(_CSV, rows)

    def __str__(self) -> str:
        head = ("score", "limit", "median", "worst", "clips above", "seconds above")
        faulty = [clip for clip in self.clips if any(map(clip.above, MEASURES))]
        clips = counted(len(self.clips), "clip")
        text = [f"{shown(self.where)}: {clips}, {len(faulty)} with a score above its limit"]
        if self.clips:
            text += table(head, [self._row(name) for name in MEASURES])
        for clip in faulty[:_CLIPS]:
            text.append(f"  {shown(clip.clip)}:")
            text += [f"    {line}" for name in MEASURES if clip.above(name) for line in [_sentence(clip, name)]]
        rest = len(faulty) - _CLIPS
        text += [f"  ... {counted(rest, 'more clip')} (all with --json, or --out FILE.csv)"] if rest > 0 else []
        left_out = left_out_lines(self.rejects)
        text += [line if line.startswith(" ") else f"  left out: {line}" for line in left_out]
        return "\n".join([*text, *([f"written to {self.file}"] if self.file else [])])

    def _row(self, name: str) -> list[object]:
        measure = MEASURES[name]
        values = [v for clip in self.clips if (v := clip.scores[name].value) is not None]
        middle, worst = (f"{np.median(values):.3g}", f"{max(values):.3g}") if values else ("-", "-")
        unit = "" if measure.unit == "1" else f" {measure.unit}"
        seconds = sum(
            end - start
            for clip in self.clips
            for start, end in (clip.seconds(span) for span in clip.scores[name].above(measure.limit))
        )
        above = "" if measure.of == "clip" else f"{seconds:.2f}"
        return [name, f"{measure.limit:g}{unit}", middle, worst, self._n_above(name), above]

    def _n_above(self, name: str) -> int:
        return sum(clip.above(name) for clip in self.clips)


def _sentence(clip: ClipQuality, name: str) -> str:
    measure, score = MEASURES[name], clip.scores[name]
    unit = "" if measure.unit == "1" else f" {measure.unit}"
    worst = sorted(score.above(measure.limit), key=lambda span: -span.value)
    places = []
    for span in worst[:_SPANS]:
        start, end = clip.seconds(span)
        joint = f" {span.joint}" if span.joint else ""
        places.append(f"{start:.2f}-{end:.2f} s{joint}")
    more = f", {len(worst) - _SPANS} more" if len(worst) > _SPANS else ""
    at = f": {', '.join(places)}{more}" if places else ""
    return f"{name} {score.value:.3g}{unit}, {measure.what}{at}"


def quality(
    what: Motion | Store | str | Path,
    *,
    dataset: str | None = None,
    recipe: RecipeLike | None = None,
    overrides: Overrides = (),
    out: str | Path | None = None,
    jobs: int | None = 1,
    cache: str | Path | None = None,
    progress: bool = True,
) -> Quality:
    """Score the faults of motions, as ``dancedata check --faults`` does.

    No file is changed. docs/archive/measured.md has the scores, their limits, and what they find of planted faults.

    Parameters
    ----------
    what
        A motion; a built dataset, its folder or its address, of which copies are left out; or a folder to build from.
    dataset
        Reader of a folder to build from, such as "folder". Default: the first one that recognises it.
    recipe, overrides
        Read a folder to build from as this recipe does, repaired and retargeted. Default: its recipe.yaml, if
        `dataset` is not given.
    out
        New .csv file, with a line for each score of a clip and for each of its spans.
    jobs, cache, progress
        As in `build`.

    Returns
    -------
    Quality
        `clips` with their scores and spans, `to_json()`, `to_csv()`; its text is the table.

    Raises
    ------
    UsageError
        For a file that exists, and a dataset without whole clips of motion.
    SourceError
        If the folder is neither a built dataset nor a source of a known one.

    Examples
    --------
    >>> import dancedata
    >>> from dancedata.synthetic import synthesise_motion
    >>> motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=240)[0]
    >>> dancedata.quality(motion).clips[0].scores["spikes"].value
    0.0
    """
    file = folder_of(out)
    require_new_csv(file)
    parsed = None if isinstance(what, Motion | Store) else chosen_recipe(what, recipe, dataset, overrides)
    reporter = Progress(quiet=not progress)
    if isinstance(what, Motion):
        result = Quality("motion", (ClipQuality("motion", what.grid.rate, score_motion(what)),))
    elif isinstance(what, Store):
        result = _of_store(what, reporter)
    else:
        path = local_folder(what)
        if (path / DATASET_FILE).exists():
            with open_store(path) as store:
                result = _of_store(store, reporter)
        else:
            result = _of_source(path, dataset, parsed, Cache.at(cache), jobs_of(jobs), reporter)
    if file is None:
        return result
    write_csv(file, result.to_csv())
    return replace(result, file=file)


def _of_store(store: Store, progress: Progress) -> Quality:
    clips, rows = [clip for clip in store if not clip.source], []
    with progress.stage("scoring clips", len(clips)) as advance:
        for clip in clips:
            motion = clip.motion()
            rows.append(ClipQuality(clip.id, motion.grid.rate, score_motion(motion)))
            advance(1)
    return Quality(str(store.path), tuple(rows))


def _of_source(
    path: Path, dataset: str | None, recipe: Recipe | None, held: Cache, jobs: int, progress: Progress
) -> Quality:
    reader, scan = scan_folder(path, dataset if recipe is None else recipe.dataset)
    if recipe is None and any(reject.reason == "missing_music" for reject in scan.rejects):
        reader, scan = scan_folder(path, _without_music(reader))
    steps = () if recipe is None else tuple(step for step in recipe.transforms if step.moves)
    by_clip, rejects = held.retry_lost(
        lambda cache: annotate_clips(cache, reader, scan, Faults(), steps, jobs=jobs, progress=progress), progress
    )
    rows = tuple(_scored(clip, of_clip) for clip, of_clip in by_clip.items())
    return Quality(str(path), rows, tuple(relative_to(reject, path) for reject in rejects))


def _scored(clip: str, rows: Sequence[Any]) -> ClipQuality:
    """Return the scores of a clip from the rows of `Faults`."""
    scores = {name: Score(value, tuple(Span(*span) for span in spans)) for name, value, spans, _ in rows}
    return ClipQuality(clip, Fraction(rows[0][-1]), scores)


def _without_music(reader: Dataset) -> Dataset:
    """Return a reader that keeps clips without music, where it has such a key: faults are those of the motion."""
    return replace(reader, music="optional") if getattr(reader, "music", None) == "required" else reader

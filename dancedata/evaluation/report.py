"""Reports of evaluations, and the list of protocols, as text, tables and JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.packages import load, package_version
from dancedata.core.sample_id import SampleId
from dancedata.core.tables import table
from dancedata.core.text import counted, listed, shown
from dancedata.core.version import __version__
from dancedata.evaluation.measuring import MeasuredClip, measure_pose
from dancedata.evaluation.music import ClipMusic
from dancedata.evaluation.pool import Pool, one_rate
from dancedata.evaluation.protocol import Protocol
from dancedata.evaluation.scores import DRAWS, Score, describe_outcome, number_text
from dancedata.evaluation.verdicts import judged_scores
from dancedata.kernel import Cache
from dancedata.scene.inputs.clip import ClipInput, MemoryClip
from dancedata.scene.poses import Pose

if TYPE_CHECKING:
    from pandas import DataFrame

#: Names of scores as in papers.
LABELS = {
    "fid_k": "FID_k", "fid_g": "FID_g", "div_k": "Div_k", "div_g": "Div_g", "bas": "BAS", "pfc": "PFC", "pbc": "PBC",
    "skating": "FSR", "skating_left": "FSR left", "skating_right": "FSR right",
    "fid_group": "GMR", "div_group": "Div group", "gmc": "GMC", "tif": "TIF", "bed": "BED",
    "fid_cd": "FID_cd", "div_cd": "Div_cd",
}  # fmt: skip
_BETTER = {"higher": "higher", "lower": "lower", "closer": "as truth"}
_NAMED = 3
#: Metrics with more numbers a clip than this are features, which no table of clips shows.
_FEW = 10


@dataclass(frozen=True, eq=False)
class Report:
    """The scores of a set of clips under a protocol.

    `clips`: Ids of the clips that were measured.
    `seconds`: Length of the shortest piece, the median and the longest.
    `pool`: Pool that the set was compared with; None: none.
    `left_out`: Clips that could not be measured, with the reason.
    `warnings`, `notes`: Remarks for readers of the numbers: on this set, and on the protocol.
    `per_clip`: A row for each piece: id, and the numbers of the metrics that have a few.
    `versions`: Of the packages that shape numbers.
    `matched`: How many files are of a clip, window or song of a dataset; "" where none is looked for.
    `recordings`: Independent clips: windows, copies and parts of one file count once.
    `truth_source`: What the real dances beside the scores are; "" without any.
    `inputs`, `music`: For pages: the clips, not loaded, and the beats of those that have music, by their ids.
    """

    protocol: Protocol
    role: str
    source: str
    scores: tuple[Score, ...]
    clips: tuple[str, ...]
    pieces: int
    fps: str
    seconds: tuple[float, float, float]
    pool: Pool | None
    left_out: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    per_clip: tuple[Mapping[str, Any], ...]
    versions: Mapping[str, str]
    matched: str = ""
    recordings: int = 0
    truth_source: str = ""
    inputs: tuple[ClipInput, ...] = ()
    music: Mapping[str, ClipMusic] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Score:
        """Return a score; UsageError if the protocol has no such score.

        Its ``value`` is None where it is undefined; ``float`` of one that means nothing is an error with the reason.
        """
        for score in self.scores:
            if score.name == name:
                return score
        raise UsageError(
            f"no score named {name!r}", where=self.protocol.name, allowed=listed(score.name for score in self.scores)
        )

    def __repr__(self) -> str:
        values = ", ".join(f"{s.name} {_shown(s)}" for s in self.scores)
        return f"Report({self.protocol.name}, {counted(len(self.clips), 'clip')}: {values})"

    def __str__(self) -> str:
        return _text(self)

    def cells(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """Return the heads of the columns of the table that have something, and a row for each score."""
        rows = [_cells(score) for score in self.scores]
        kept = [k for k in range(len(_HEAD)) if any(row[k] != "" for row in rows)]
        return tuple(_HEAD[k] for k in kept), [tuple(row[k] for k in kept) for row in rows]

    def table(self) -> list[str]:
        """Return the lines of the table of scores, each with the reason of its verdict."""
        head, rows = self.cells()
        n = len(head) - (head[-1] == "")
        lines = table(head[:n], [row[:n] for row in rows])
        reasons = (score.reason for score in self.scores)
        return [lines[0], *(f"{line}  {why}".rstrip() for line, why in zip(lines[1:], reasons, strict=True))]

    def label(self, name: str) -> str:
        """Return the name of a score, or of a number of `per_clip`, as in papers."""
        return LABELS.get(name, name)

    @property
    def verdict(self) -> str:
        """What all scores together are worth, in a sentence."""
        void, weak = ([s for s in self.scores if s.verdict == verdict] for verdict in ("void", "weak"))
        n, of = len(self.scores), clips_text(self)
        if n and len(void) == n:
            codes = Counter(score.why[0].code for score in void)
            want = "" if codes.most_common(1)[0][0] != "few_clips" else ", mostly for want of clips"
            return f"Nothing here is a result: {of}; {n} of {n} scores mean nothing{want}"
        parts = [f"{len(scores)} {word}" for scores, word in ((weak, "weak"), (void, "without a meaning")) if scores]
        none = "no score compares with another set: " if n and len(weak) + len(void) == n else ""
        n_better = sum(score.why[0].code == "below_truth" for score in self.scores if score.why)
        better = f"; {n_better} better than real dances: look for copies of train" if n_better else ""
        text = f"{none}{of}: {counted(n, 'score')}{', ' * bool(parts)}{' and '.join(parts)}{better}"
        return f"{text[0].upper()}{text[1:]}"

    def numbers(self) -> dict[str, float]:
        """Return the scores that mean something, by name, and the number of independent clips: for loggers."""
        values = {s.name: s.value for s in self.scores if s.verdict != "void" and s.value is not None}
        return {**values, "n_clips": float(self.recordings)}

    def to_pandas(self, table: str = "scores") -> DataFrame:
        """Return a table as a pandas DataFrame.

        `table`: "scores": a row a score, with its interval as "low" and "high", what stands beside it, and the number
            of clips without a value. "clips": the rows of `per_clip`.
        Raises UsageError: for another table.
        Raises MissingPackageError: without pandas.
        """
        tables: dict[str, Sequence[Mapping[str, Any]]] = {
            "scores": [_score_row(score) for score in self.scores],
            "clips": self.per_clip,
        }
        if table not in tables:
            raise UsageError(f"no table named {table!r}", fix=did_you_mean(table, tables))
        frame: DataFrame = load("pandas", "pandas", what="to_pandas").DataFrame.from_records(list(tables[table]))
        return frame

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "protocol": self.protocol.name,
            "version": self.protocol.version,
            "role": self.role,
            "source": self.source,
            "matched": self.matched,
            "verdict": self.verdict,
            "scores": {s.name: s.to_json() for s in self.scores},
            "truth": self.truth_source,
            "recordings": self.recordings,
            "clips": len(self.clips),
            "pieces": self.pieces,
            "fps": self.fps,
            "seconds": dict(zip(("min", "median", "max"), self.seconds, strict=True)),
            "pool": None if self.pool is None else self.pool.to_json(),
            "left_out": [{"clip": clip, "reason": reason} for clip, reason in self.left_out],
            "not_computable": dict(self.protocol.not_computable),
            "warnings": list(self.warnings),
            "notes": list(self.notes),
            "versions": dict(self.versions),
            "citation": self.protocol.citation,
        }


def _score_row(score: Score) -> dict[str, Any]:
    row = score.to_json()
    low, high = row.pop("interval_95") or (None, None)
    value, same, why, n = (row.pop(key) for key in ("value", "same_n", "why", "n"))
    ends = {f"same_n_{key}": None if same is None else same[key] for key in ("low", "median", "high")}
    row |= {**ends, "reason": why[0]["text"] if why else "", **n, "undefined": score.n_undefined}
    return {"score": score.name, "value": value, "low": low, "high": high, **row}


def clips_text(report: Report) -> str:
    """Return the number of independent clips, and of samples where there are more."""
    n, samples = report.recordings, len(report.clips)
    return counted(n, "clip") if n == samples else f"{counted(samples, 'sample')} of {counted(n, 'clip')}"


def _text(report: Report) -> str:
    low, middle, high = report.seconds
    lengths = f"{low:.2f} s" if low == high else f"{low:.2f} to {high:.2f} s, median {middle:.2f} s"
    lines = [
        *([report.matched] if report.matched else []),
        f"{report.protocol.label}: {shown(report.source)} as {report.role}",
        f"  {clips_text(report)}, {counted(report.pieces, 'piece')}, {report.fps} frames per second, {lengths}",
        f"  pool: {_pool_text(report)}" + (f"; truth: {shown(report.truth_source)}" if report.truth_source else ""),
        *report.table(),
        report.verdict,
    ]
    lines += [f"  not computable: {name}: {why}" for name, why in report.protocol.not_computable.items()]
    lines += _undefined_lines(report.scores)
    if report.left_out:
        lines.append(f"  left out: {counted(len(report.left_out), 'clip')}")
        lines += [f"    {shown(clip)}: {shown(reason, 500)}" for clip, reason in report.left_out[:_NAMED]]
        more = len(report.left_out) - _NAMED
        lines += [f"    and {more} more, which --json lists"] * (more > 0)
    return "\n".join([*lines, *(f"  warning: {warning}" for warning in report.warnings)])


_HEAD = ("score", "better", "value", "95 %", "truth", "at this n", "chance", "published", "clips", "")


def _shown(score: Score) -> str:
    """Return a value as it is printed: in brackets if it means nothing, after ~ if it is of this set alone."""
    form = {"void": "({})", "weak": "~{}", "ok": "{}"}[score.verdict if score.value is not None else "ok"]
    return form.format(number_text(score.value))


def _ends(low: float, high: float) -> str:
    return f"{low:.3g} .. {high:.3g}"


def _cells(score: Score) -> tuple[Any, ...]:
    interval, truth, same = score.interval if score.verdict == "ok" else None, score.truth_interval, score.same_n
    return (
        LABELS.get(score.name, score.name),
        _BETTER[score.better],
        _shown(score),
        "" if interval is None else _ends(interval.low, interval.high),
        "" if score.truth is None else number_text(score.truth) if truth is None else _ends(truth.low, truth.high),
        "" if same is None else _ends(same.low, same.high),
        *("" if value is None else number_text(value) for value in (score.chance, score.published)),
        score.recordings,
        score.reason,
    )


def _pool_text(report: Report) -> str:
    if report.pool is None:
        return "none"
    pool = report.pool
    return f"{shown(pool.source)}, {counted(len(pool.ids), 'clip')}, {counted(pool.n, 'vector')}"


def _undefined_lines(scores: Sequence[Score]) -> list[str]:
    lines: dict[str, list[str]] = {}
    for score in scores:
        for outcome, ids in score.undefined.items():
            which = f": {listed(ids, _NAMED)}" if ids else ""
            text = f"{describe_outcome(outcome)} ({outcome}), {counted(len(ids), 'piece')}{which}"
            lines.setdefault(text, []).append(LABELS.get(score.name, score.name))
    return [f"  undefined: {', '.join(names)}: {text}" for text, names in lines.items()]


def report_of(
    protocol: Protocol,
    measured: Sequence[MeasuredClip],
    pool: Pool | None,
    *,
    role: str,
    source: str,
    draws: int = DRAWS,
    numbers: Sequence[int] | None = None,
    left_out: Iterable[tuple[str, str]] = (),
    warnings: Iterable[str] = (),
    matched: str = "",
    truth: Sequence[MeasuredClip] = (),
    truth_source: str = "",
    in_pool: int = 0,
    dataset: str = "",
    cache: Cache | None = None,
) -> Report:
    """Compare measured clips with a pool, by all measures or by `numbers` of them, and judge the scores.

    Scores are computed again for intervals at most `draws` times. `truth` are the real dances beside generated ones,
    `in_pool` is the number of clips that the pool has too, and `cache` keeps distances of real dances. `dataset` is
    the reader of the real dances: figures that were published of others are left out. UsageError if rates are mixed,
    or the pool is of another protocol, version or rate.
    """
    ordered = sorted(measured, key=lambda m: m.id)
    per_clip = per_clip_rows(protocol, ordered)
    fps = one_rate(ordered, source)
    if pool is not None:
        pool.require(protocol, fps)
    scores, of_scores = judged_scores(
        protocol, ordered, truth, pool, generated=role == "generated", draws=draws, numbers=numbers, in_pool=in_pool,
        dataset=dataset, cache=cache,
    )  # fmt: skip
    return Report(
        protocol=protocol,
        role=role,
        source=source,
        matched=matched,
        recordings=len({m.clip for m in ordered}),
        truth_source=truth_source if truth else "",
        scores=scores,
        clips=tuple(m.id for m in ordered),
        pieces=sum(len(m.cuts) for m in ordered),
        fps=fps,
        seconds=lengths_of([s for m in ordered for s in m.seconds]),
        pool=pool,
        left_out=tuple(left_out),
        warnings=(*warnings, *of_scores, *_same_as(ordered, truth)),
        notes=(*sorted({note for m in ordered for note in m.notes}), *protocol.notes),
        per_clip=tuple(per_clip),
        versions={"dancedata": __version__, **{name: package_version(name) for name in ("numpy", "scipy")}},
    )


def scores_of_clip(rules: Protocol, pose: Pose, beats: MusicBeats | None) -> dict[str, float | None]:
    """Return the scores of one clip that need no pool; DataError if the clip cannot be measured."""
    numbers = [number for number, measure in enumerate(rules.measures) if not measure.metric.needs_pool]
    music = None if beats is None else ClipMusic(beats)
    clip = MemoryClip(id="clip", joints=pose.joints, grid=pose.grid)
    measured = MeasuredClip.of(clip, measure_pose(rules, "generated", numbers, pose, music))
    report = report_of(rules, [measured], None, role="generated", source="clip", draws=0, numbers=numbers)
    return {score.name: score.value for score in report.scores}


def _same_as(measured: Sequence[MeasuredClip], truth: Sequence[MeasuredClip]) -> list[str]:
    """Return a warning if samples have the numbers of the very dances that they are of."""
    real = {m.id: m for m in truth}
    dances = [(m, real.get(m.id) or real.get(str(replace(SampleId.parse(m.id), take=0)))) for m in measured]
    same = [m.id for m, dance in dances if dance is not None and m.same_numbers(dance)]
    of = f"{len(same)} of {counted(len(measured), 'sample')}"
    be = "is a dance of the dataset itself" if len(same) == 1 else "are the dances of the dataset themselves"
    return [f"{of} {be}"] if same else []


def lengths_of(seconds: Sequence[float]) -> tuple[float, float, float]:
    """Return least, median and largest length; zeros without pieces."""
    if not seconds:
        return 0.0, 0.0, 0.0
    return float(min(seconds)), float(np.median(seconds)), float(max(seconds))


def per_clip_rows(protocol: Protocol, measured: Sequence[MeasuredClip]) -> list[dict[str, Any]]:
    """Return a row for each piece: id, frames, and the numbers of metrics that have at most ten, or the outcome."""
    rows = []
    for m in measured:
        for k, (_, n_frames) in enumerate(m.cuts):
            row: dict[str, Any] = {"clip": m.id, "piece": k, "frames": n_frames}
            for number, measure in enumerate(protocol.measures):
                columns = measure.metric.columns
                outcomes = m.rows.get(number)
                if len(columns) > _FEW or outcomes is None:
                    continue
                outcome = outcomes[k]
                values = [outcome] * len(columns) if isinstance(outcome, str) else list(outcome)
                row |= dict(zip(columns, values, strict=True))
            rows.append(row)
    return rows

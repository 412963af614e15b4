"""Reports of evaluations, and the list of protocols, as text, tables and JSON."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.packages import load
from dancedata.core.text import counted, listed, shown, table
from dancedata.core.version import __version__
from dancedata.evaluation.measuring import MeasuredClip
from dancedata.evaluation.pool import Pool, one_rate, rows_of
from dancedata.evaluation.protocol import PROTOCOLS, Protocol
from dancedata.evaluation.scores import Score, describe_outcome, halves_of, scores_of
from dancedata.execution.cache import package_version
from dancedata.recipes.documents import document_of

if TYPE_CHECKING:
    from pandas import DataFrame

#: Names of scores as in papers.
LABELS = {
    "fid_k": "FID_k", "fid_g": "FID_g", "div_k": "Div_k", "div_g": "Div_g", "bas": "BAS", "pfc": "PFC", "pbc": "PBC",
    "skating": "FSR", "skating_left": "FSR left", "skating_right": "FSR right",
    "fid_group": "GMR", "div_group": "Div group", "gmc": "GMC", "tif": "TIF", "bed": "BED",
    "fid_cd": "FID_cd", "div_cd": "Div_cd",
}  # fmt: skip
_ARROWS = {"higher": "up", "lower": "down", "closer": "truth"}
_NAMED = 3
#: Characters that mean something in a cell of a Markdown table, and in LaTeX.
_MARKDOWN = "\\|*`<["
_LATEX = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}",
    ">": r"\textgreater{}", "|": r"\textbar{}",
}  # fmt: skip
#: Metrics with more numbers a clip than this are features, which no table of clips shows.
_FEW = 10


@dataclass(frozen=True, eq=False)
class Report:
    """The scores of a set of clips under a protocol.

    Attributes
    ----------
    protocol
        Protocol of the scores.
    role
        "truth" or "generated".
    source
        Origin of the clips.
    scores
        One for each line of the table.
    clips
        Ids of the clips that were measured.
    pieces
        Number of pieces.
    fps
        Frames per second that were measured.
    seconds
        Length of the shortest piece, the median and the longest.
    pool
        Pool that the set was compared with; None: none.
    left_out
        Clips that could not be measured, with the reason.
    warnings, notes
        Remarks for readers of the numbers: on this set, and on the protocol.
    per_clip
        A row for each piece: id, and the numbers of the metrics that have a few.
    versions
        Of the packages that shape numbers.
    matched
        How many files are of a clip, window or song of a dataset; "" where none is looked for.
    """

    protocol: Protocol
    role: str
    source: str
    scores: tuple[Score, ...]
    clips: tuple[str, ...]
    pieces: int
    fps: str
    seconds: tuple[float, float, float]
    pool: Mapping[str, Any] | None
    left_out: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    per_clip: tuple[Mapping[str, Any], ...]
    versions: Mapping[str, str]
    matched: str = ""

    def __getitem__(self, name: str) -> float | None:
        """Return the value of a score, None where it is undefined; UsageError if the protocol has no such score."""
        for score in self.scores:
            if score.name == name:
                return score.value
        raise UsageError(
            f"no score named {name!r}", where=self.protocol.name, allowed=listed(score.name for score in self.scores)
        )

    def __repr__(self) -> str:
        values = ", ".join(f"{s.name} {_number(s.value)}" for s in self.scores)
        return f"Report({self.protocol.name}, {counted(len(self.clips), 'clip')}: {values})"

    def __str__(self) -> str:
        return describe(self)

    def to_pandas(self, table: str = "scores") -> DataFrame:
        """Return a table as a pandas DataFrame.

        Parameters
        ----------
        table
            "scores": a row a score, with its interval as "low" and "high", what stands beside it, and the number of
            clips without a value. "clips": the rows of `per_clip`.

        Raises
        ------
        UsageError
            For another table.
        MissingPackageError
            Without pandas.
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
            "scores": {s.name: _score_json(s) for s in self.scores},
            "clips": len(self.clips),
            "pieces": self.pieces,
            "fps": self.fps,
            "seconds": dict(zip(("min", "median", "max"), self.seconds, strict=True)),
            "pool": self.pool,
            "left_out": [{"clip": clip, "reason": reason} for clip, reason in self.left_out],
            "not_computable": dict(self.protocol.not_computable),
            "warnings": list(self.warnings),
            "notes": list(self.notes),
            "versions": dict(self.versions),
            "citation": self.protocol.citation,
        }


def _score_row(score: Score) -> dict[str, Any]:
    row = _score_json(score)
    low, high = row.pop("interval_95") or (None, None)
    value = row.pop("value")
    return {"score": score.name, "value": value, "low": low, "high": high, **row, "undefined": score.n_undefined}


def _score_json(score: Score) -> dict[str, Any]:
    interval = None if score.interval is None else [score.interval.low, score.interval.high]
    return {
        "value": score.value, "interval_95": interval, "median": score.median, "chance": score.chance,
        "pool": score.pool, "halves": score.halves, "n": score.n,
        "undefined": {k: list(v) for k, v in score.undefined.items()},
        "published": score.published, "better": score.better,
    }  # fmt: skip


def describe(report: Report) -> str:
    """Return the text that ``dancedata evaluate`` prints."""
    low, middle, high = report.seconds
    lengths = f"{low:.2f} s" if low == high else f"{low:.2f} to {high:.2f} s, median {middle:.2f} s"
    lines = [
        *([report.matched] if report.matched else []),
        f"{report.protocol.label}: {shown(report.source)} as {report.role}",
        f"  {counted(len(report.clips), 'clip')}, {counted(report.pieces, 'piece')}, {report.fps} frames per second, "
        f"{lengths}",
        f"  pool: {_pool_text(report)}",
        *table(_HEAD, [_cells(score) for score in report.scores]),
    ]
    lines += [f"  not computable: {name}: {why}" for name, why in report.protocol.not_computable.items()]
    lines += _undefined_lines(report.scores)
    if report.left_out:
        lines.append(f"  left out: {counted(len(report.left_out), 'clip')}")
        lines += [f"    {shown(clip)}: {shown(reason, 500)}" for clip, reason in report.left_out[:_NAMED]]
        more = len(report.left_out) - _NAMED
        lines += [f"    and {more} more, which --json lists"] * (more > 0)
    lines += [f"  warning: {warning}" for warning in report.warnings]
    lines += [f"  note: {note}" for note in report.notes]
    versions = ", ".join(f"{name} {version}" for name, version in report.versions.items())
    return "\n".join([*lines, f"  versions: {versions}"])


_HEAD = (
    "score",
    "value",
    "95 % interval",
    "median",
    "chance",
    "pool",
    "halves",
    "published",
    "n",
    "undefined",
    "better",
)


def _cells(score: Score) -> tuple[Any, ...]:
    interval = "" if score.interval is None else f"{_number(score.interval.low)} .. {_number(score.interval.high)}"
    beside = [
        _number(v) if v is not None else ""
        for v in (score.median, score.chance, score.pool, score.halves, score.published)
    ]
    name = LABELS.get(score.name, score.name)
    return (name, _number(score.value), interval, *beside, score.n, score.n_undefined or "", _ARROWS[score.better])


def _number(value: float | None) -> str:
    if value is None:
        return "undefined"
    return f"{value:.4g}" if value and (abs(value) < 0.01 or abs(value) >= 1e5) else f"{value:.4f}"


def _pool_text(report: Report) -> str:
    if report.pool is None:
        return "none"
    pool = report.pool
    return f"{shown(pool['source'])}, {counted(pool['clips'], 'clip')}, {counted(pool['vectors'], 'vector')}"


def _undefined_lines(scores: Sequence[Score]) -> list[str]:
    lines: dict[str, list[str]] = {}
    for score in scores:
        for outcome, ids in score.undefined.items():
            which = f": {listed(ids, _NAMED)}" if ids else ""
            text = f"{describe_outcome(outcome)} ({outcome}), {counted(len(ids), 'piece')}{which}"
            lines.setdefault(text, []).append(LABELS.get(score.name, score.name))
    return [f"  undefined: {', '.join(names)}: {text}" for text, names in lines.items()]


def markdown(report: Report) -> str:
    """Return the scores as a Markdown table of two lines, values with their intervals; of a path, its last part."""
    head = " | ".join(LABELS.get(s.name, s.name) for s in report.scores)
    values = " | ".join(_with_interval(s, " [{}, {}]") for s in report.scores)
    rule = "|".join("---:" for _ in report.scores)
    return f"| {report.protocol.name} | {head} |\n|---|{rule}|\n| {_escaped(Path(report.source).name)} | {values} |"


def latex(report: Report) -> str:
    """Return the scores as a LaTeX table with the protocol as its caption."""
    arrows = {"higher": r"$\uparrow$", "lower": r"$\downarrow$", "closer": r"$\rightarrow$"}
    head = " & ".join(f"{_latex_name(s.name)} {arrows[s.better]}" for s in report.scores)
    values = " & ".join(_with_interval(s, r" {{\scriptsize [{}, {}]}}") for s in report.scores)
    name = _escaped(report.protocol.label, latex=True)
    return "\n".join(
        [
            r"\begin{table}",
            f"\\begin{{tabular}}{{l{'r' * len(report.scores)}}}",
            rf"\hline & {head} \\ \hline",
            rf"{_escaped(Path(report.source).name, latex=True)} & {values} \\ \hline",
            r"\end{tabular}",
            rf"\caption{{Protocol {name}; {counted(len(report.clips), 'clip')}, {report.fps} frames per second.}}",
            r"\end{table}",
        ]
    )


TABLES: dict[str, Callable[[Report], str]] = {"latex": latex, "markdown": markdown}


def _with_interval(score: Score, form: str) -> str:
    if score.interval is None:
        return _number(score.value)
    return _number(score.value) + form.format(_number(score.interval.low), _number(score.interval.high))


def _latex_name(name: str) -> str:
    first, _, last = LABELS.get(name, name).partition("_")
    return f"${first}_{last}$" if last and len(last) == 1 else LABELS.get(name, name).replace("_", r"\_")


def _escaped(text: str, latex: bool = False) -> str:
    plain = shown(text)
    if not latex:
        return "".join(f"\\{c}" if c in _MARKDOWN else c for c in plain)
    return "".join(_LATEX.get(c, c) for c in plain)


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
    matched: str = "",
) -> Report:
    """Compare measured clips with a pool, by all measures or by `numbers` of them.

    Scores are computed again for intervals at most `draws` times. UsageError if rates are mixed, or the pool is of
    another protocol, version or rate.
    """
    ordered = sorted(measured, key=lambda m: m.id)
    fps = one_rate(ordered, source)
    if pool is not None:
        pool.require(protocol, fps)
    seconds = lengths_of([s for m in ordered for s in m.seconds])
    per_clip = tuple(per_clip_rows(protocol, ordered))
    changed = sorted({note for m in ordered for note in m.notes})
    figures = [p.values for p in protocol.published if p.what == "ground truth"]
    published = {name: value for values in figures for name, value in values.items()}
    scores: list[Score] = []
    of_scores: list[str] = []
    for number in range(len(protocol.measures)) if numbers is None else numbers:
        metric = protocol.measures[number].metric
        rows = rows_of(ordered, number, metric)
        of_metric, messages = scores_of(metric, rows, None if pool is None else pool.rows.get(number), draws=draws)
        halves = {}
        if pool is not None and number in pool.clips:
            halves = halves_of(metric, pool.rows[number], pool.clips[number])
        scores += [
            replace(score, published=published.get(score.name), halves=halves.get(score.name)) for score in of_metric
        ]
        of_scores += messages
    return Report(
        protocol=protocol,
        role=role,
        source=source,
        matched=matched,
        scores=tuple(scores),
        clips=tuple(m.id for m in ordered),
        pieces=sum(len(m.cuts) for m in ordered),
        fps=fps,
        seconds=seconds,
        pool=None if pool is None else pool.to_json(),
        left_out=tuple(left_out),
        warnings=(*warnings, *dict.fromkeys(of_scores)),
        notes=(*changed, *protocol.notes),
        per_clip=per_clip,
        versions={"dancedata": __version__, **{name: package_version(name) for name in ("numpy", "scipy")}},
    )


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


def protocols_json() -> dict[str, Any]:
    """Return every protocol with all that its numbers depend on."""
    return {name: _protocol_json(PROTOCOLS.get(name)()) for name in PROTOCOLS.names()}


def _protocol_json(protocol: Protocol) -> dict[str, Any]:
    rule, music = protocol.motion, protocol.music
    return {
        "version": protocol.version,
        "about": (inspect.getdoc(type(protocol)) or "").split("\n\n")[0].replace("\n", " "),
        "citation": protocol.citation,
        "source": protocol.source,
        "licence": protocol.licence_note,
        "motion": {"body": rule.body, "fps": rule.fps, "up": rule.up, "pelvis": rule.pelvis},
        "truth": str(protocol.truth),
        "generated": str(protocol.generated),
        "metrics": [{m.metric.name: document_of(m.metric), "fps": m.fps} for m in protocol.measures],
        "music": None
        if music is None
        else {"features": list(music.features), "fps": music.fps, "by_piece": music.by_piece},
        "published": [
            {"what": p.what, "values": dict(p.values), "source": p.source, "note": p.note} for p in protocol.published
        ],
        "not_computable": dict(protocol.not_computable),
        "notes": list(protocol.notes),
    }


def describe_protocols() -> str:
    """Return the output of ``dancedata evaluate --list-protocols``."""
    lines = []
    for name, protocol in protocols_json().items():
        motion = protocol["motion"]
        rate = f"{motion['fps']} frames per second" if motion["fps"] else "any frame rate"
        lines += [
            f"{name}, version {protocol['version']}: {protocol['about']}",
            f"  {motion['body']}, {rate}, {motion['up']} up",
        ]
        lines.append(f"  ground truth: {protocol['truth']}; generated: {protocol['generated']}")
        metrics = ["".join(_call(n, d) for n, d in m.items() if n != "fps") for m in protocol["metrics"]]
        lines.append(f"  metrics: {', '.join(metrics)}")
        for row in protocol["published"]:
            values = ", ".join(f"{LABELS.get(k, k)} {v:g}" for k, v in row["values"].items())
            lines.append(f"  published, {row['what']}: {values} ({row['source']})")
        lines.append(f"  from: {protocol['source']}")
    return "\n".join(lines)


def _call(name: str, parameters: dict[str, Any]) -> str:
    return f"{name}({', '.join(f'{v}' for v in parameters.values() if isinstance(v, str))})"

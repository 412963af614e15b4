"""Tables of scores for papers: Markdown and LaTeX, in which a score that means nothing is a dash."""

from collections.abc import Sequence
from pathlib import Path

from dancedata.core.text import shown
from dancedata.evaluation.report import LABELS, Report, clips_text
from dancedata.evaluation.scores import Score, number_text

#: Characters that mean something in a cell of a Markdown table, and in LaTeX.
_MARKDOWN = "\\|*`<["
_LATEX = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}",
    ">": r"\textgreater{}", "|": r"\textbar{}",
}  # fmt: skip


def markdown(reports: Sequence[Report]) -> str:
    """Return the scores as a Markdown table, a row a report, values with their intervals; notes have the reasons."""
    scores, rows = _scores(reports), []
    for report, name in zip(reports, _sources(reports), strict=True):
        values = " | ".join(_in_table(_score(report, score), " [{}, {}]", "†") for score in scores)
        rows.append(f"| {_escaped(name)} | {values} |")
    head = " | ".join(LABELS.get(name, name) for name in scores)
    lines = [f"| {reports[0].protocol.name} | {head} |", f"|---|{'|'.join('---:' for _ in scores)}|", *rows]
    return "\n".join(lines) + "".join(f"\n\n{_escaped(note)}" for note in _notes(reports, "†"))


def latex(reports: Sequence[Report]) -> str:
    """Return the scores as a LaTeX table, a row a report; the caption has protocol and reasons."""
    arrows = {"higher": r"$\uparrow$", "lower": r"$\downarrow$", "closer": r"$\rightarrow$"}
    scores, rows = _scores(reports), []
    for report, name in zip(reports, _sources(reports), strict=True):
        values = " & ".join(_in_table(_score(report, s), r" {{\scriptsize [{}, {}]}}", r"\dag") for s in scores)
        rows.append(rf"{_escaped(name, latex=True)} & {values} \\")
    head = " & ".join(f"{_latex_name(name)} {arrows[score.better]}" for name, score in scores.items())
    caption = _escaped(" ".join(_notes(reports, "+")), latex=True).replace("+ ", r"\dag{} ")
    return "\n".join([
        r"\begin{table}", rf"\begin{{tabular}}{{l{'r' * len(scores)}}}", rf"\hline & {head} \\ \hline", *rows,
        r"\hline", r"\end{tabular}", rf"\caption{{{caption}}}", r"\end{table}",
    ])  # fmt: skip


def _scores(reports: Sequence[Report]) -> dict[str, Score]:
    """Return a score of each name that a report has, in their order."""
    return {score.name: score for report in reports for score in report.scores}


def _score(report: Report, name: str) -> Score | None:
    return next((score for score in report.scores if score.name == name), None)


def _sources(reports: Sequence[Report]) -> list[str]:
    """Return the last part of each path; the whole ones where two are alike."""
    names = [Path(report.source).name for report in reports]
    return names if len(set(names)) == len(names) else [report.source for report in reports]


def _notes(reports: Sequence[Report], mark: str) -> list[str]:
    """Return the note of a report, or of each by its name."""
    names = _sources(reports) if len(reports) > 1 else [""]
    return [f"{name}: {note}" if name else note
            for name, note in zip(names, [_note(report, mark) for report in reports], strict=True)]  # fmt: skip


def _in_table(score: Score | None, form: str, mark: str) -> str:
    if score is None:
        return ""
    if score.verdict != "ok" or score.interval is None:
        return {"void": "-", "weak": number_text(score.value) + mark, "ok": number_text(score.value)}[score.verdict]
    return number_text(score.value) + form.format(number_text(score.interval.low), number_text(score.interval.high))


def _note(report: Report, mark: str) -> str:
    """Return what a table has to say below it: protocol, clips, and the reasons of weak and left out scores."""
    of_reason: dict[tuple[str, str], list[str]] = {}
    for score in (score for score in report.scores if score.verdict != "ok"):
        of_reason.setdefault((score.verdict, score.reason), []).append(LABELS.get(score.name, score.name))
    marks = {"weak": mark, "void": "-"}
    reasons = [f"{marks[verdict]} {', '.join(names)}: {reason}" for (verdict, reason), names in of_reason.items()]
    about = f"Protocol {report.protocol.label}; {clips_text(report)}, {report.fps} frames per second."
    return " ".join([about, *(f"{reason}." for reason in reasons)])


def _latex_name(name: str) -> str:
    first, _, last = LABELS.get(name, name).partition("_")
    return f"${first}_{last}$" if last and len(last) == 1 else LABELS.get(name, name).replace("_", r"\_")


def _escaped(text: str, latex: bool = False) -> str:
    plain = shown(text, 2000)
    if not latex:
        return "".join(f"\\{c}" if c in _MARKDOWN else c for c in plain)
    return "".join(_LATEX.get(c, c) for c in plain)

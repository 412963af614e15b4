"""Tables of scores for papers: Markdown and LaTeX, in which a score that means nothing is a dash."""

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


def markdown(report: Report) -> str:
    """Return the scores as a Markdown table of two lines, values with their intervals; of a path, its last part.

    A score that means nothing is a dash; a note has the reasons.
    """
    head = " | ".join(LABELS.get(s.name, s.name) for s in report.scores)
    values = " | ".join(_in_table(s, " [{}, {}]", "†") for s in report.scores)
    rule = "|".join("---:" for _ in report.scores)
    name, note = _escaped(Path(report.source).name), _escaped(_note(report, "†"))
    return f"| {report.protocol.name} | {head} |\n|---|{rule}|\n| {name} | {values} |\n\n{note}"


def latex(report: Report) -> str:
    """Return the scores as a LaTeX table with the protocol as its caption; a score that means nothing is a dash."""
    arrows = {"higher": r"$\uparrow$", "lower": r"$\downarrow$", "closer": r"$\rightarrow$"}
    head = " & ".join(f"{_latex_name(s.name)} {arrows[s.better]}" for s in report.scores)
    values = " & ".join(_in_table(s, r" {{\scriptsize [{}, {}]}}", r"\dag") for s in report.scores)
    return "\n".join(
        [
            r"\begin{table}",
            f"\\begin{{tabular}}{{l{'r' * len(report.scores)}}}",
            rf"\hline & {head} \\ \hline",
            rf"{_escaped(Path(report.source).name, latex=True)} & {values} \\ \hline",
            r"\end{tabular}",
            rf"\caption{{{_escaped(_note(report, '+'), latex=True).replace('+ ', chr(92) + 'dag{} ')}}}",
            r"\end{table}",
        ]
    )


def _in_table(score: Score, form: str, mark: str) -> str:
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

"""HTML that nothing from a dataset can break out of, numbers as text, and figures with their tables."""

import html
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from dancedata.core.text import shown

#: Size of a drawing; width of a column of the page, CSS pixels; characters in a line of a note.
_VIEW_BOX = re.compile(r'viewBox="0 0 ([\d.]+) ([\d.]+)"')
_COLUMN, _LINE = 390, 58


def escaped(value: object, limit: int = 200) -> str:
    """Return text for HTML and attributes: printable, truncated, and without characters that mean something there."""
    return html.escape(shown(value, limit), quote=True)


def number(value: Any) -> str:
    """Return a number with three or four digits: 1,408, 12.5, 0.0123; a dash for None, other values as text."""
    if value is None:
        return "–"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return escaped(value)
    if isinstance(value, int) or (abs(value) >= 1000 and value == round(value)):
        return f"{int(value):,}"
    text = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}" if abs(value) < 1 else f"{value:.4g}"
    return text.replace("-", "−") if text != "-0" else "0"


def rounded(value: float | None) -> str:
    """Return a measured number with two digits, as sentences and marks have it: 140, 3.0, 0.41."""
    if value is None or not value:
        return number(value)
    places = 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, places):,.{max(places, 0)}f}".replace("-", "−")


def percent(share: float | None) -> "Markup":
    """Return a share as whole per cent; a dash for None."""
    return Markup("–" if share is None else f"{100 * share:.0f}\xa0%")


def table(head: Sequence[str], rows: Iterable[Sequence[Any]], kind: str = "") -> str:
    """Return a table; cells that are `Markup` are kept, all others are escaped."""
    top = "".join(f'<th scope="col">{escaped(cell)}</th>' for cell in head)
    labels = [f' data-label="{escaped(cell)}"' if kind.startswith("list") else "" for cell in head]
    body = "".join(f"<tr>{''.join(map(_cell, row, labels, range(len(row))))}</tr>" for row in rows)
    attributes = f' class="{kind}"' if kind else ""
    return f"<table{attributes}><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def scrolled(head: Sequence[str], rows: Iterable[Sequence[Any]], kind: str = "list") -> str:
    """Return a table of a kind in a frame that scrolls sideways."""
    return f'<div class="scroll">{table(head, rows, kind)}</div>'


def name_text(name: str) -> "Markup":
    """Return a name for HTML that may be broken after its underscores."""
    return Markup(escaped(name).replace("_", "_<wbr>"))


class Markup(str):
    """HTML that this package made."""


def _cell(cell: Any, label: str, place: int) -> str:
    text = str(cell) if isinstance(cell, Markup) else number(cell)
    return f"<td{label}>{text}</td>" if place else f'<th scope="row">{text}</th>'


@dataclass(frozen=True)
class Figure:
    """A figure of the page."""

    key: str  # its id in the page, without the prefix
    title: str
    note: str
    body: str
    # `head`, `rows`: its numbers, below it
    head: tuple[str, ...] = ()
    rows: tuple[tuple[Any, ...], ...] = ()
    legend: tuple[str, ...] = ()  # names of the groups that colours stand for, in order
    # `other`, `chance`: what dashed outlines stand for, and dotted ones; "" without them
    other: str = ""
    chance: str = ""
    kind: str = ""  # "" for a column of the page, "wide" for the whole width
    sortable: bool = False  # whether the table of its numbers is sorted by the head that is pressed

    @property
    def height(self) -> float:
        """Approximate height of the figure in a column, CSS pixels: drawings at the column's width, lines, rows."""
        drawings = sum(_COLUMN * float(high) / float(wide) for wide, high in _VIEW_BOX.findall(self.body))
        legend = 24 * (len(self.legend) > 1 or bool(self.other or self.chance))
        numbers = 24 * bool(self.rows)
        lines = 19 * math.ceil(len(self.note) / _LINE) + 24 * self.body.count("<p>")
        return 64 + drawings + legend + numbers + lines + 27 * self.body.count("<tr>")

    def to_html(self) -> str:
        """Return the figure with title, legend and numbers."""
        note = f"<small>{escaped(self.note, 600)}</small>" if self.note else ""
        caption = f"<figcaption>{escaped(self.title)}{note}</figcaption>"
        kind = f' class="{self.kind}"' if self.kind else ""
        return f'<figure id="r-{self.key}"{kind}>{caption}{self._legend()}{self.body}{self._numbers()}</figure>'

    def _legend(self) -> str:
        entries = [f'<span><i class="s{k % 6}"></i>{escaped(name)}</span>' for k, name in enumerate(self.legend)]
        if len(entries) < 2:
            entries = []  # one colour needs no name
        for kind, name in (("chance", self.chance), ("other", self.other)):
            if name:
                entries.append(f'<span><i class="{kind}"></i>{escaped(name)}</span>')
        return f'<p class="legend">{"".join(entries)}</p>' if entries else ""

    def _numbers(self) -> str:
        if not self.rows:
            return ""
        rows = scrolled(self.head, self.rows, "sortable" if self.sortable else "")
        return f"<details><summary>numbers</summary>{rows}</details>"

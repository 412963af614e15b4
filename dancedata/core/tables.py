"""Tables and documents for people: lines of a table, cells of CSV, and JSON, none of which a terminal obeys."""

import json
import re
from collections.abc import Iterable, Sequence
from typing import Any

from dancedata.core.text import printable, shown

#: Characters that JSON does not escape, but that may control a terminal or cannot be written as UTF-8.
_UNPRINTABLE = re.compile(r"[^\x00-\x7e]")


def json_text(obj: Any) -> str:
    """Return indented JSON with printable characters as they are, and all others as JSON escape sequences."""
    text = json.dumps(obj, indent=1, ensure_ascii=False)
    if text.isascii() and "\x7f" not in text:
        return text
    return _UNPRINTABLE.sub(
        lambda match: match[0] if printable(match[0]) == match[0] else json.dumps(match[0])[1:-1], text
    )


#: Beginnings of cells that spreadsheets run as formulas, after the apostrophes that `csv_cell` writes.
_FORMULA = re.compile(r"'*[=+\-@\t\r\n]")


def csv_cell(value: object) -> object:
    """Return a cell for CSV: text that a spreadsheet would run gets an apostrophe before it, numbers stay numbers."""
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def csv_text(cell: str) -> str:
    """Return the text of a cell that `csv_cell` wrote."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> list[str]:
    """Return the lines of a table, indented by two spaces: the first column to the left, the others to the right."""
    cells = [[shown(cell) for cell in row] for row in [head, *rows]]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    return [
        "  "
        + "  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in cells
    ]

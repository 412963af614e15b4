"""The table that `align` and `quality` write."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from dancedata.core.errors import UsageError
from dancedata.files.atomic import write_text


def require_new_csv(file: Path | None) -> None:
    """Raise UsageError for a file that exists or is not a .csv file; None: nothing is written."""
    if file is not None and (file.suffix.lower() != ".csv" or file.exists()):
        problem = "the file exists already" if file.exists() else "not a .csv file"
        raise UsageError(problem, where=file, allowed="a new .csv file", fix="choose another name")


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()


def write_csv(file: Path, text: str) -> None:
    """Write the table; UsageError if the file cannot be written."""
    try:
        write_text(file, text)
    except OSError as error:
        raise UsageError(
            "the file cannot be written", where=file, found=str(error), fix="choose another name"
        ) from error

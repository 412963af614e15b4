"""Files that `dancedata evaluate --out` writes, by their suffixes."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.tables import csv_cell, json_text
from dancedata.evaluation.report import Report
from dancedata.evaluation.tables import latex, markdown
from dancedata.files.atomic import write_text

#: The first columns of a table of clips.
_HEAD = ("clip", "piece", "frames")


def clips_csv(reports: Sequence[Report]) -> str:
    """Return a row for each piece: clip, piece, frames, and the numbers of the metrics that have a few."""
    rows = [row for report in reports for row in report.per_clip]
    names = list(dict.fromkeys((*_HEAD, *(name for row in rows for name in row))))
    return "".join(_line(cells) for cells in [names, *([row.get(name, "") for name in names] for row in rows)])


def _line(cells: Sequence[object]) -> str:
    text = io.StringIO()
    csv.writer(text).writerow(map(csv_cell, cells))  # its line terminator makes it quote \\r and \\n
    return text.getvalue().removesuffix("\r\n") + "\n"


#: Text of files by their suffix.
_TEXTS: dict[str, Callable[[Sequence[Report]], str]] = {
    ".csv": clips_csv,
    ".json": lambda reports: json_text({"reports": [report.to_json() for report in reports]}) + "\n",
    ".md": lambda reports: markdown(reports) + "\n",
    ".tex": lambda reports: latex(reports) + "\n",
}


@dataclass(frozen=True)
class Outputs:
    """Files to write: texts, and the pool as an .npz file."""

    texts: tuple[Path, ...]
    pool: Path | None = None

    @classmethod
    def of(cls, paths: Sequence[Path], *, overwrite: bool = False) -> Outputs:
        """Check the names before anything is measured; UsageError for other suffixes, and files that exist."""
        texts = tuple(path for path in paths if path.suffix.lower() in _TEXTS)
        pools = [path for path in paths if path.suffix.lower() == ".npz"]
        if len(texts) + len(pools) < len(paths) or len(pools) > 1:
            raise UsageError("scores are written by suffix", found=", ".join(path.name for path in paths),
                             allowed=f"{', '.join(_TEXTS)}, and one .npz", fix="choose another name")  # fmt: skip
        for path in texts:
            if not path.parent.is_dir() or path.is_dir() or (path.exists() and not overwrite):
                problem = "the file exists" if path.exists() else "its folder does not exist"
                raise UsageError(problem, where=path, fix="choose another name, or overwrite it",
                                 options="choose another --out, or --overwrite")  # fmt: skip
        return cls(texts, pools[0] if pools else None)

    def write(self, reports: Sequence[Report]) -> None:
        """Write the texts; the pool is written where it is computed."""
        for path in self.texts:
            try:
                write_text(path, _TEXTS[path.suffix.lower()](reports))
            except OSError as error:
                raise StoreError("the scores cannot be written", where=path, found=str(error)) from error

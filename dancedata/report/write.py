"""write_report: a dataset as a page and as numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.core import atomic
from dancedata.core.columns import Columns
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.text import shown
from dancedata.pipeline.diff import Difference, diff
from dancedata.report.document import SCHEMA, Document, document
from dancedata.report.figures import Drawing
from dancedata.report.left_out import spread
from dancedata.report.markup import Figure
from dancedata.report.measure import measure
from dancedata.report.page import PageParts, page
from dancedata.report.pictures import heat_map
from dancedata.report.scales import Scales
from dancedata.store import Store, open_store

__all__ = ["Report", "write_report"]

#: Bytes of a megabyte, as file managers count.
_MB = 1_000_000
#: Clips whose paths are drawn.
_PATHS = 12


@dataclass(frozen=True)
class Report:
    """A report.

    Attributes
    ----------
    document
        Every number of the page; see docs/report.md.
    other
        Those of the dataset it is compared with.
    differences
        Between both datasets.
    path
        The page; None if none was written.
    """

    document: Document
    other: Document | None = None
    differences: tuple[Difference, ...] = ()
    path: Path | None = None

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "schema": SCHEMA,
            "path": None if self.path is None else str(self.path),
            "report": self.document,
            "against": self.other,
            "differences": [d.to_json() for d in self.differences],
        }


def write_report(
    store: str | Path,
    to: str | Path | None = None,
    *,
    against: str | Path | None = None,
    max_mb: float = 20,
    overwrite: bool = False,
) -> Report:
    """Summarise a built dataset, as ``dancedata report`` does.

    Parameters
    ----------
    store
        Folder that `build` wrote.
    to
        HTML file to write; None: numbers alone.
    against
        Another dataset, whose numbers stand beside those of this one.
    max_mb
        Largest page, megabytes.
    overwrite
        Replace a file that is there.

    Returns
    -------
    Report
        Equal datasets give equal numbers and equal bytes of the page.

    Raises
    ------
    UsageError
        If the file is there, lies inside a dataset, or would be larger than `max_mb`.
    DataError, StoreError
        If a dataset is damaged.
    """
    target = (
        None if to is None else _target(Path(to), [Path(p) for p in (store, against) if p is not None], overwrite)
    )
    with open_store(store) as own:
        found = measure(own)
        if against is None:
            return _made(own, document(found, Scales.of([found])), None, (), target, max_mb)
        with open_store(against) as other:
            beside = measure(other)
            scales = Scales.of([found, beside])
            differences = tuple(diff(own.path, other.path))
            return _made(own, document(found, scales), document(beside, scales), differences, target, max_mb)


def _made(
    store: Store, own: Document, other: Document | None, differences: tuple[Difference, ...], target: Path | None,
    max_mb: float,
) -> Report:  # fmt: skip
    if target is not None:
        html = _page(store, own, other, differences).encode()
        _require_size(len(html), max_mb, target)
        try:
            atomic.write_bytes(target, html)
        except OSError as error:
            raise StoreError("the report cannot be written", where=target, found=str(error)) from error
    return Report(own, other, differences, target)


def _page(store: Store, own: Document, other: Document | None, differences: Sequence[Difference]) -> str:
    chosen = spread(own, _PATHS)
    texts = [(d.kind, str(d).partition(": ")[2]) for d in differences]
    columns: Mapping[str, Columns] = store.fields
    return page(Drawing(own, other), PageParts(chosen, columns, _heat_maps(store, own), texts))


def _heat_maps(store: Store, own: Document) -> dict[str, Figure]:
    """Return the heat map of each field, of the longest clip."""
    if not own["clips"]:
        return {}
    clip = max(own["clips"], key=lambda row: (row["frames"], row["clip"]))["clip"]
    windows = [w for split in store.splits for w in store.windows(split) if w.clip == clip]
    if store.scope == "window" and not windows:
        return {}
    figures = {}
    for name, columns in store.fields.items():
        rows = store.read_clip(clip, name) if store.scope == "track" else store.read(windows[0], name)
        if not len(rows):
            continue
        note = f"clip {shown(clip)}; time to the right, each line scaled by its own 2nd and 98th percentile"
        body = heat_map(rows, columns, f"columns of {name} over time")
        figures[name] = Figure(f"heat_{name}", f"{name} over time", note, body, kind="wide")
    return figures


def _target(to: Path, stores: Sequence[Path], overwrite: bool) -> Path:
    path = to.expanduser().absolute()
    for store in stores:
        folder = store.expanduser().absolute()
        if path.resolve().is_relative_to(folder.resolve()):
            raise UsageError(
                "a report is not written into a dataset, whose files are listed",
                where=path,
                fix="choose a file outside of the dataset with --to",
            )
    if path.is_dir() or not path.parent.is_dir():
        problem = "this is a folder" if path.is_dir() else "there is no such folder"
        raise UsageError(problem, where=path if path.is_dir() else path.parent, fix="name an HTML file with --to")
    if path.exists() and not overwrite:
        raise UsageError("the file is already there", where=path, fix="choose another --to, or add --overwrite")
    return path


def _require_size(n_bytes: int, max_mb: float, path: Path) -> None:
    if n_bytes > max_mb * _MB:
        raise UsageError(
            "the page is too large",
            where=path,
            found=f"{n_bytes / _MB:.1f} MB",
            allowed=f"{max_mb:g} MB (--max-mb)",
            fix="show fewer clips: --clips N, or none of them: --clips none",
        )


def default_path(store: str | Path) -> Path:
    """Return NAME-report.html in the current folder; of names that are no file names only the usual characters."""
    with open_store(store) as own:
        name = "".join(c if c.isascii() and (c.isalnum() or c in "._+-") else "_" for c in own.meta.get("name", ""))
    return Path(f"{name.lstrip('.') or 'dataset'}-report.html")

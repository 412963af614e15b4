"""A page, and the folder of further files beside it: written whole, and never over what is another's."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.version import __version__
from dancedata.files import publish
from dancedata.files.atomic import already_there, atomic_file, require_free, write_bytes
from dancedata.files.atomic_folder import atomic_folder, foreign_files, read_about, remove_listed

#: Bytes of a megabyte, as file managers count.
_MB = 1_000_000


@dataclass(frozen=True)
class PageFiles:
    """A page, and the folder of further files beside it."""

    path: Path
    max_mb: float

    @classmethod
    def of(cls, to: Path, stores: Sequence[Path], what: str = "report", *, max_mb: float, overwrite: bool) -> Self:
        """Check the destination of a report or card."""
        target = cls(require_free(to, stores, what, overwrite=overwrite), max_mb)
        if not overwrite and os.path.lexists(target.folder):
            raise already_there(target.folder)
        target._require_own_folder()
        return target

    @property
    def folder(self) -> Path:
        """Folder with further clips: "report.html" has "report_files". Its export.json lists its files."""
        return self.path.with_name(f"{self.path.stem}_files")

    def write(self, html: bytes, side: Mapping[str, Callable[[], bytes]]) -> None:
        """Write the page last, so that it never names missing files; those of `side` are made one at a time."""
        self._require_size(len(html))
        try:
            with atomic_file(self.path) as page:
                page.write_bytes(html)
                if side:
                    with atomic_folder(self.folder, overwrite=True) as folder:
                        for name, make in side.items():
                            folder.write_bytes(name, make())
                        folder.finish({"dancedata": __version__, "report": self.path.name})
            if not side and self._listing() is not None:
                remove_listed(self.folder)  # of an earlier page
        except OSError as error:
            raise StoreError("the report cannot be written", where=self.path, found=str(error)) from error

    def _require_size(self, n_bytes: int) -> None:
        if n_bytes > self.max_mb * _MB:
            raise UsageError("the page is too large", where=self.path, found=f"{n_bytes / _MB:.1f} MB",
                             allowed=f"{self.max_mb:g} MB",
                             fix="show fewer clips (--clips 4, or none), or omit the music, which takes most of the "
                             "space")  # fmt: skip

    def _listing(self) -> dict[str, Any] | None:
        """Return the files of the folder as a report of this name lists them; None if none wrote it."""
        record = None if self.folder.is_symlink() else read_about(self.folder)
        return record["files"] if record is not None and record.get("report") == self.path.name else None

    def _require_own_folder(self) -> None:
        if not os.path.lexists(self.folder):
            return
        foreign = ["a file or a link"]
        if self.folder.is_dir() and not self.folder.is_symlink():
            files = self._listing()
            names = sorted(p.name for p in self.folder.iterdir())
            foreign = names if files is None else foreign_files(self.folder, files)
        if foreign:
            raise publish.foreign_files(self.folder, foreign,
                                        problem="the folder for further clips has other files in it",
                                        allowed="the files of a report of this name, as they were written",
                                        choose="another --to", error=UsageError)  # fmt: skip


def save_page(path: Path, page: str) -> Path:
    """Write a page, and return its path; StoreError if it cannot be written."""
    try:
        write_bytes(path, page.encode())
    except OSError as error:
        raise StoreError("the page cannot be written", where=path, found=str(error)) from error
    return path

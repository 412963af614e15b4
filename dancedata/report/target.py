"""The files of a report: the page, and a folder with further clips beside it."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.version import __version__
from dancedata.exports.base.folder import ExportFolder
from dancedata.exports.base.place import (
    foreign_files,
    read_about,
    remove_export,
    replaced_export,
    write_about,
)
from dancedata.files import atomic, publish
from dancedata.files.atomic import require_free
from dancedata.report.player import Player

#: Bytes of a megabyte, as file managers count.
_MB = 1_000_000


@dataclass(frozen=True)
class Target:
    """Where a report is written.

    Attributes
    ----------
    path
        The page.
    max_mb
        Largest page, megabytes.
    """

    path: Path
    max_mb: float

    @classmethod
    def of(cls, to: Path, stores: Sequence[Path], *, max_mb: float, overwrite: bool) -> Self:
        """Check where the page and its folder go.

        Raises
        ------
        UsageError
            If the file is there and is not to be replaced, or lies inside one of the datasets; if the folder holds
            files that no report of this name wrote, or that were changed since.
        """
        target = cls(require_free(to, stores, "report", overwrite=overwrite), max_mb)
        if not overwrite and os.path.lexists(target.folder):
            fix = "choose another --to, or add --overwrite"
            raise UsageError("the file is already there", where=target.folder, fix=fix)
        target._require_own_folder()
        return target

    @property
    def folder(self) -> Path:
        """Folder with further clips: "report.html" has "report_files". Its export.json lists its files."""
        return self.path.with_name(f"{self.path.stem}_files")

    def write(self, html: bytes, player: Player) -> None:
        """Write the page last, so that it never names files that are not there.

        Raises
        ------
        UsageError
            If the page is too large; then nothing is written.
        StoreError
            If a file cannot be written.
        """
        self._require_size(len(html))
        try:
            with atomic.atomic_file(self.path) as page:
                page.write_bytes(html)
                if player.side:
                    self._write_folder(player)
            if not player.side and self._listing() is not None:
                remove_export(self.folder)  # of an earlier page
        except OSError as error:
            raise StoreError("the report cannot be written", where=self.path, found=str(error)) from error

    def _require_size(self, n_bytes: int) -> None:
        if n_bytes > self.max_mb * _MB:
            raise UsageError(
                "the page is too large",
                where=self.path,
                found=f"{n_bytes / _MB:.1f} MB",
                allowed=f"{self.max_mb:g} MB (--max-mb)",
                fix="show fewer clips: --clips 4, or --clips none; music takes most of it: --audio none",
            )

    def _write_folder(self, player: Player) -> None:
        with replaced_export(self.folder, overwrite=True) as new:
            folder = ExportFolder(new, self.folder)
            for name, number in player.side.items():
                folder.write_text(name, player.side_file(number))
            write_about(folder, {"dancedata": __version__, "report": self.path.name})

    def _listing(self) -> dict[str, Any] | None:
        """Return the files of the folder as a report of this name has listed them; None if none wrote it."""
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
            raise publish.foreign_files(
                self.folder,
                foreign,
                problem="the folder for further clips has other files in it",
                allowed="the files of a report of this name, as they were written",
                choose="another --to",
                error=UsageError,
            )

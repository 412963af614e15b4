"""The files of a report: the page, and a folder with further clips beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from dancedata.core import atomic
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.text import listed
from dancedata.exporting.place import require_outside
from dancedata.report.player import Player

__all__ = ["Target"]

#: Bytes of a megabyte, as file managers count.
_MB = 1_000_000
#: Names of the files in the folder.
_OWN = re.compile(r"clip-\d{5,}\.js")


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
            If the file is there and is not to be replaced, or lies inside one of the datasets.
        """
        path = to.expanduser()
        require_outside(path, stores, "report")
        if path.is_dir() or not path.absolute().parent.is_dir():
            problem = "this is a folder" if path.is_dir() else "the folder of this file does not exist"
            raise UsageError(problem, where=path, fix="name an HTML file with --to")
        made = cls(path, max_mb)
        if not overwrite and (path.exists() or made.folder.exists()):
            there = path if path.exists() else made.folder
            raise UsageError("the file is already there", where=there, fix="choose another --to, or add --overwrite")
        made._require_own_folder()
        return made

    @property
    def folder(self) -> Path:
        """Folder with further clips: "report.html" has "report_files"."""
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
            if player.side:
                self.folder.mkdir(exist_ok=True)
            for name, number in player.side.items():
                atomic.write_text(self.folder / name, player.side_file(number))
            atomic.write_bytes(self.path, html)
            self._remove_old(player)
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

    def _require_own_folder(self) -> None:
        if not self.folder.exists():
            return
        names = sorted(p.name for p in self.folder.iterdir()) if self.folder.is_dir() else []
        foreign = [name for name in names if not _is_own(name)]
        if foreign or not self.folder.is_dir():
            raise UsageError(
                "the folder for further clips has other files in it",
                where=self.folder,
                found=listed(foreign) or "a file",
                fix="choose another --to",
            )

    def _remove_old(self, player: Player) -> None:
        """Remove what an earlier page of the same name had beside it, and nothing that came there since."""
        if not self.folder.is_dir():
            return
        for path in list(self.folder.iterdir()):
            if _is_own(path.name) and path.name not in player.side:
                path.unlink()
        if not player.side:
            with suppress(OSError):  # not empty, or a link
                self.folder.rmdir()


def _is_own(name: str) -> bool:
    return _OWN.fullmatch(name) is not None or atomic.is_temporary(name)

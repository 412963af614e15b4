"""Swap: replaces a folder as a whole by another one, which is written beside it and renamed."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from dancedata.files.atomic import OWN, sync_folder
from dancedata.files.staging import MARKER, claim


@dataclass(frozen=True)
class Swap:
    """How one kind of folder is replaced.

    Beside OUT there may be, of a process that is writing or was killed::

        .dancedata-NAME.new-<8 digits>    the folder that will be OUT, with a marker that says that it is ours
        .dancedata-NAME.old-<8 digits>    the folder that is replaced

    The caller holds a lock on OUT.

    Attributes
    ----------
    prefix
        Put before "new" and "old", so that kinds are told apart.
    is_whole
        Tells whether a folder is finished.
    remove
        Removes a folder if it is proved to be ours.
    """

    prefix: str
    is_whole: Callable[[Path], bool]
    remove: Callable[[Path], None]

    @contextmanager
    def swapped(self, out: Path, check: Callable[[], None]) -> Iterator[Path]:
        """Give a folder to write to; on success it becomes `out`, and what was there is removed.

        On any exception the new folder is removed, and `out` stays as it was.

        Parameters
        ----------
        check
            Raises where `out` must not be replaced. Called when all is written, which may take hours.
        """
        real, digits = out.resolve(), uuid4().hex[:8]
        new, old = (real.with_name(f"{OWN}{real.name}.{self.prefix}{which}-{digits}") for which in ("new", "old"))
        claim(new)
        try:
            yield new
            check()
            (new / MARKER).unlink()
            if os.path.lexists(real):
                os.rename(real, old)
            os.rename(new, real)
        except BaseException:
            if os.path.lexists(old) and not os.path.lexists(real):
                os.rename(old, real)
            if os.path.lexists(new):
                self.remove(new)
            raise
        sync_folder(real.parent)
        if os.path.lexists(old):
            self.remove(old)

    def put_right(self, out: Path) -> None:
        """Put the old folder back where a process was killed half way."""
        if os.path.lexists(out):
            return
        whole = [folder for folder in self._beside(out, "old") if self.is_whole(folder)]
        if whole:
            os.rename(max(whole, key=lambda folder: folder.stat().st_ctime_ns), out.resolve())

    def tidy(self, out: Path) -> None:
        """Remove what killed processes left beside `out`."""
        for folder in self._beside(out, "new|old"):
            self.remove(folder)

    def _beside(self, out: Path, which: str) -> list[Path]:
        real = out.resolve()
        ours = re.compile(rf"{re.escape(OWN + real.name)}\.{re.escape(self.prefix)}({which})-[0-9a-f]{{8}}")
        try:
            found = [real.parent / name for name in os.listdir(real.parent) if ours.fullmatch(name)]
        except OSError:
            return []
        return sorted(folder for folder in found if folder.is_dir() and not folder.is_symlink())

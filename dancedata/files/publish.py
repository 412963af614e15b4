"""Folders that appear whole: filled under names of dancedata's and moved to their place at the end.

A folder OUT that is empty, or holds other files, is filled from a folder within it (`staged`)::

    OUT/.dancedata-unfinished/       is being written; dancedata-unfinished.json in it proves that it is dancedata's
    OUT/.dancedata-dataset.json      last file of a folder that is complete: now the others are moved
    OUT/dataset.json                 complete, and nothing else of dancedata's

The replacement of a folder OUT is written next to it (`swapped`); a running or killed writer leaves::

    .dancedata-NAME.lock              held by the writer
    .dancedata-NAME.new-<8 digits>    the folder that will be OUT, with the marker
    .dancedata-NAME.old-<8 digits>    the folder that is replaced

A process may be killed at any moment: the next one calls `recover` and `tidy`, with a lock on OUT. Only files with
names that a `Layout` allows are removed, in folders that are proved to be dancedata's.
"""

import logging
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from dancedata.core.errors import DanceDataError, StoreError
from dancedata.core.system import flush_folder
from dancedata.core.text import listed
from dancedata.files.atomic import PREFIX, is_temporary, write_bytes

#: The folder in which OUT is filled, and the file that proves that it, or another folder, is dancedata's.
STAGING = f"{PREFIX}unfinished"
MARKER = "dancedata-unfinished.json"
_PROOF = b'{"dancedata": "an unfinished folder; it may be removed when nothing writes to it"}\n'
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Layout:
    """The files of one kind of folder."""

    last: str  # name of the file that completes a folder
    is_complete: Callable[[Path], bool]  # whether a file is such a one
    is_ours: Callable[[str], bool]  # whether the writer gives a file this name
    erase: Callable[[Path], object] | None = None  # removes a swapped folder; default: `discard`
    prefix: str = ""  # before "new" and "old" of a swap

    @property
    def journal(self) -> str:
        """Name of the last file while the others are moved to their places."""
        return f"{PREFIX}{self.last}"

    def remove(self, folder: Path) -> None:
        """Remove a folder of a swap; log a warning if something of it stays."""
        if self.erase is None:
            discard(folder, self)
        else:
            self.erase(folder)
        if os.path.lexists(folder):
            _log.warning("%s is left: it holds something that dancedata did not write, or is in use", folder)


@contextmanager
def writable(out: Path, problem: str, fix: str, error: type[DanceDataError] = StoreError) -> Iterator[None]:
    """Turn an OSError into an error that names the folder."""
    try:
        yield
    except OSError as cause:
        raise error(problem, where=out, found=str(cause), fix=fix) from cause


def foreign_files(
    folder: Path,
    names: Iterable[str],
    *,
    problem: str = "the folder holds files that dancedata did not write",
    allowed: str | None = None,
    choose: str = "another folder",
    error: type[DanceDataError] = StoreError,
) -> DanceDataError:
    """Return the error of a folder with files that are not dancedata's."""
    fix = f"choose {choose}, or move them away; nothing was written"
    return error(problem, where=folder, found=listed(names), allowed=allowed, fix=fix)


@contextmanager
def new_folders(folder: Path) -> Iterator[None]:
    """Make a folder and those above it; remove those that were made and are empty at the end."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for path in missing:
            with suppress(OSError):
                path.rmdir()


@contextmanager
def staged(out: Path, layout: Layout) -> Iterator[Path]:
    """Yield a folder to fill; on success its files become those of `out`, `layout.last` as the last one."""
    staging = out / STAGING
    claim(staging)
    try:
        yield staging
        _require_free(out, [*_written(staging, layout), layout.last])
        os.rename(staging / layout.last, out / layout.journal)
    except BaseException:
        if not os.path.lexists(out / layout.journal):
            discard(staging, layout)
        raise
    _finish(out, layout)


@contextmanager
def swapped(out: Path, layout: Layout, check: Callable[[], None]) -> Iterator[Path]:
    """Yield a folder to fill; on success and after `check`, it becomes `out`, which stays on any exception."""
    real, digits = out.resolve(), uuid4().hex[:8]
    new, old = (real.with_name(f"{PREFIX}{real.name}.{layout.prefix}{which}-{digits}") for which in ("new", "old"))
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
            layout.remove(new)
        raise
    flush_folder(real.parent)
    if os.path.lexists(old):
        layout.remove(old)


def recover(out: Path, layout: Layout) -> None:
    """Move the folder before back to `out` where a process was killed while it swapped them."""
    if os.path.lexists(out):
        return
    complete = [
        folder
        for folder in _beside(out, layout, "old")
        if layout.is_complete(folder / layout.last) and not is_claimed(folder)
    ]
    if complete:
        os.rename(max(complete, key=lambda folder: folder.stat().st_ctime_ns), out.resolve())


def tidy(out: Path, layout: Layout) -> None:
    """Finish moving the files of a complete folder, and remove unfinished ones in `out` and next to it."""
    journal, staging = out / layout.journal, out / STAGING
    if os.path.lexists(journal):
        if not layout.is_complete(journal):
            raise foreign_files(out, [journal.name])
        _finish(out, layout)
    elif os.path.lexists(staging):
        _written(staging, layout)
        discard(staging, layout)
    for folder in _beside(out, layout, "new|old"):
        layout.remove(folder)


def claim(folder: Path) -> None:
    """Create a folder with the marker."""
    folder.mkdir()
    try:
        mark(folder)
    except BaseException:
        with suppress(OSError):  # an interrupt may come when the file, or a temporary one, exists already
            (folder / MARKER).unlink(missing_ok=True)
            folder.rmdir()
        raise


def mark(folder: Path) -> None:
    """Write the marker of an unfinished folder."""
    write_bytes(folder / MARKER, _PROOF)


def is_claimed(folder: Path) -> bool:
    """Return whether a folder has the marker."""
    marker = folder / MARKER
    try:
        return _is_file(marker) and marker.stat().st_size == len(_PROOF) and marker.read_bytes() == _PROOF
    except OSError:
        return False


def discard(folder: Path, layout: Layout) -> bool:
    """Remove a folder that `claim` made, unless anything foreign is in it; return whether it is gone."""
    if _foreign_in(folder, layout):
        return False
    with suppress(OSError):
        # The proof goes last.
        for name in sorted(os.listdir(folder), key=lambda name: name == MARKER):
            (folder / name).unlink()
        folder.rmdir()
    return not os.path.lexists(folder)


def _foreign_in(folder: Path, layout: Layout) -> list[str]:
    """List foreign entries; every entry if the marker is missing."""
    if folder.is_symlink() or not folder.is_dir():
        return [folder.name]
    names = sorted(os.listdir(folder))
    if not is_claimed(folder):
        # A process killed while writing the marker leaves an empty folder, or one with a temporary file.
        return [name for name in names if not (is_temporary(name) and _is_file(folder / name))]
    return [n for n in names if not (_is_file(folder / n) and (n == MARKER or is_temporary(n) or layout.is_ours(n)))]


def _is_file(path: Path) -> bool:
    return stat.S_ISREG(path.lstat().st_mode)


def _written(staging: Path, layout: Layout) -> list[str]:
    """Return the names of the writer's files but the last one; StoreError if there is anything else."""
    foreign = _foreign_in(staging, layout)
    if foreign:
        raise foreign_files(staging, foreign)
    return sorted(name for name in os.listdir(staging) if layout.is_ours(name) and name != layout.last)


def _require_free(out: Path, names: list[str]) -> None:
    taken = [name for name in names if os.path.lexists(out / name)]
    if taken:
        raise foreign_files(out, taken)


def _finish(out: Path, layout: Layout) -> None:
    """Move the files of a complete folder to their places; idempotent."""
    staging = out / STAGING
    _require_free(out, [layout.last])
    if os.path.lexists(staging):
        written = _written(staging, layout)
        _require_free(out, written)
        for name in written:
            os.rename(staging / name, out / name)
        discard(staging, layout)
    flush_folder(out)
    os.rename(out / layout.journal, out / layout.last)
    flush_folder(out)


def _beside(out: Path, layout: Layout, which: str) -> list[Path]:
    """Return the folders of swaps of `out`."""
    real = out.resolve()
    names = re.compile(rf"{re.escape(PREFIX + real.name)}\.{re.escape(layout.prefix)}({which})-[0-9a-f]{{8}}")
    try:
        folders = [real.parent / name for name in os.listdir(real.parent) if names.fullmatch(name)]
    except OSError:
        return []
    return sorted(folder for folder in folders if folder.is_dir() and not folder.is_symlink())

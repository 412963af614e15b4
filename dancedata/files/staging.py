"""Folders of files that appear whole: written beside their place, under names of our own, and moved there at the end.

A folder OUT is filled in a folder within it, so that nothing beside it is needed::

    OUT/.dancedata-unfinished/       what is being written; dancedata-unfinished.json in it says that it is ours
    OUT/.dancedata-dataset.json      the last file of a folder that is written whole: now the others are moved
    OUT/dataset.json                 all is there, and nothing else of ours

A process may be killed at any moment. The next one finishes what the second file is there for, and else begins anew.
Nothing is removed but files with names that a writer gives, in folders that are proved to be ours.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.errors import StoreError
from dancedata.core.text import listed
from dancedata.files.atomic import OWN, is_temporary, sync_folder, write_bytes

#: The folder in which OUT is filled, and what proves that it, or another folder, is ours.
STAGING = f"{OWN}unfinished"
MARKER = "dancedata-unfinished.json"
_PROOF = b'{"dancedata": "an unfinished folder; it may be removed when nothing writes to it"}\n'


@dataclass(frozen=True)
class Layout:
    """What a writer makes.

    Attributes
    ----------
    last
        Name of the file that says that a folder is whole.
    is_whole
        Tells whether a file is such a one.
    is_own
        Tells whether a name is one that the writer gives to a file.
    """

    last: str
    is_whole: Callable[[Path], bool]
    is_own: Callable[[str], bool]

    @property
    def journal(self) -> str:
        """Name of the last file while the others are moved to their places."""
        return f"{OWN}{self.last}"


@contextmanager
def staged(out: Path, layout: Layout) -> Iterator[Path]:
    """Give a folder to write to; on success its files become those of `out`, `layout.last` as the last one.

    On any exception what was written is removed again. The caller has called `tidy`, and has a lock on `out`.

    Raises
    ------
    StoreError
        If `out` holds a file by now that would be replaced.
    OSError
        Where nothing can be written.
    """
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


def tidy(out: Path, layout: Layout) -> None:
    """Finish what a process was killed in moving to its place, or remove what it had not finished writing.

    Raises
    ------
    StoreError
        If there is something under our names that is not ours, which is left as it is; or a file that would be
        replaced.
    """
    journal, staging = out / layout.journal, out / STAGING
    if os.path.lexists(journal):
        if not layout.is_whole(journal):
            raise _foreign(out, [journal.name])
        _finish(out, layout)
    elif os.path.lexists(staging):
        _written(staging, layout)
        discard(staging, layout)


def claim(folder: Path) -> None:
    """Make a folder and say in it that it is ours."""
    folder.mkdir()
    try:
        mark(folder)
    except BaseException:
        with suppress(OSError):  # an interrupt may come when the file, or a temporary one, is there already
            (folder / MARKER).unlink(missing_ok=True)
            folder.rmdir()
        raise


def mark(folder: Path) -> None:
    """Say in a folder that it is ours, and not whole."""
    write_bytes(folder / MARKER, _PROOF)


def discard(folder: Path, layout: Layout) -> bool:
    """Remove a folder that `claim` made, with what a writer makes; tells whether it is gone.

    Whatever else is in it stays, and so does the folder.
    """
    if foreign_in(folder, layout):
        return False
    with suppress(OSError):
        # The proof goes last.
        for name in sorted(os.listdir(folder), key=lambda name: name == MARKER):
            (folder / name).unlink()
        folder.rmdir()
    return not os.path.lexists(folder)


def foreign_in(folder: Path, layout: Layout) -> list[str]:
    """Return what is not ours in a folder with a name of ours; all that is in it, if nothing proves that it is."""
    if folder.is_symlink() or not folder.is_dir():
        return [folder.name]
    names = sorted(os.listdir(folder))
    if not is_claimed(folder):
        # A process killed while it was saying so leaves an empty folder, or one with a temporary file.
        return [name for name in names if not (is_temporary(name) and _is_file(folder / name))]
    return [n for n in names if not (_is_file(folder / n) and (n == MARKER or is_temporary(n) or layout.is_own(n)))]


def is_claimed(folder: Path) -> bool:
    """Tell whether a folder is one that `claim` has made."""
    marker = folder / MARKER
    try:
        return _is_file(marker) and marker.stat().st_size == len(_PROOF) and marker.read_bytes() == _PROOF
    except OSError:
        return False


def _is_file(path: Path) -> bool:
    return stat.S_ISREG(path.lstat().st_mode)


def _written(staging: Path, layout: Layout) -> list[str]:
    """Return the names of what a writer made; StoreError if there is anything else."""
    foreign = foreign_in(staging, layout)
    if foreign:
        raise _foreign(staging, foreign)
    return sorted(name for name in os.listdir(staging) if layout.is_own(name) and name != layout.last)


def _require_free(out: Path, names: list[str]) -> None:
    taken = [name for name in names if os.path.lexists(out / name)]
    if taken:
        raise _foreign(out, taken)


def _finish(out: Path, layout: Layout) -> None:
    """Move what is written to its place; it may have been begun before."""
    staging = out / STAGING
    _require_free(out, [layout.last])
    if os.path.lexists(staging):
        written = _written(staging, layout)
        _require_free(out, written)
        for name in written:
            os.rename(staging / name, out / name)
        discard(staging, layout)
    sync_folder(out)
    os.rename(out / layout.journal, out / layout.last)
    sync_folder(out)


def _foreign(folder: Path, names: list[str]) -> StoreError:
    return StoreError(
        "the folder holds files that are not dancedata's",
        where=folder,
        found=listed(names),
        fix="move them to another place, or choose another folder; they were left as they are",
    )

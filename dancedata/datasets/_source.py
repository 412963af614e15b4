"""Small helpers of dataset readers for looking at a source folder and saying what is there."""

from __future__ import annotations

from pathlib import Path

from dancedata.core.errors import SourceError
from dancedata.core.regular_file import read_regular
from dancedata.core.text import counted, listed, quoted

__all__ = ["counted", "describe", "list_folder", "read_names", "relative", "require_folder"]

MAX_LIST_BYTES = 1 << 24
"""A list of names is never larger."""
MAX_NAMES = 100_000
"""A list of names never has more."""
MAX_NAME = 255
"""Bytes of a file name."""


def list_folder(folder: Path) -> list[Path]:
    """Entries of a folder by name; hidden ones (``.DS_Store``) and ``__MACOSX`` are skipped.

    Raises
    ------
    SourceError
        If the folder cannot be read.
    """
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise SourceError(
            "the folder cannot be read",
            where=str(folder),
            found=error.strerror or str(error),
            fix="check the path and its permissions",
        ) from error
    return [entry for entry in entries if not entry.name.startswith(".") and entry.name != "__MACOSX"]


def require_folder(dataset: str, source: Path, looked_for: str) -> None:
    """Check that `source` is a folder with something in it.

    Raises
    ------
    SourceError
        If it is missing, a file, unreadable or empty. Says what was looked for and what is there.
    """
    if source.is_dir():
        if list_folder(source):
            return
        problem, found = f"{dataset}: the source folder is empty", "nothing"
    elif source.exists():
        problem, found = f"{dataset}: the source is not a folder", "a file"
    else:
        problem = f"{dataset}: the source folder does not exist"
        parent = source.absolute().parent
        found = f"in {parent}: {describe(parent)}" if parent.is_dir() else f"no folder {parent} either"
    raise SourceError(
        problem, where=str(source), found=found, allowed=looked_for, fix="give --source the data set's folder"
    )


def describe(folder: Path) -> str:
    """Say what a folder holds, in a few words: folders with a slash, then files, then how many more."""
    entries = list_folder(folder)
    folders = [f"{entry.name}/" for entry in entries if entry.is_dir()]
    files = [entry.name for entry in entries if not entry.is_dir()]
    return listed([*folders, *files]) if entries else "nothing"


def relative(path: Path, source: Path) -> str:
    """Path below the source with forward slashes; of a file that lies elsewhere, its folder's name and its own.

    Where things lie on this machine is no part of a dataset.
    """
    try:
        return path.relative_to(source).as_posix()
    except ValueError:
        return f"{path.parent.name}/{path.name}"


def read_names(path: Path) -> list[str]:
    """First word of every line of a list of names; empty lines and lines with ``#`` in front are skipped.

    Raises
    ------
    SourceError
        If the file cannot be read, is not text, or holds what is no list of names.
    """
    try:
        lines = read_regular(path, MAX_LIST_BYTES).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise _no_list(path, str(error)) from error
    words = (line.split(maxsplit=1) for line in lines)
    names = [parts[0] for parts in words if parts and not parts[0].startswith("#")]
    longest = max(names, key=len, default="")
    if len(names) > MAX_NAMES or len(longest) > MAX_NAME:
        many = f"{len(names):,} names" if len(names) > MAX_NAMES else f"a name of {len(longest):,} characters"
        raise _no_list(path, f"{many}, {quoted(longest, 40)}")
    return names


def _no_list(path: Path, found: str) -> SourceError:
    return SourceError(
        "the list of names cannot be read",
        where=str(path),
        found=found,
        allowed=f"a UTF-8 text file, one name a line, at most {MAX_NAMES:,} of {MAX_NAME} characters",
        fix="replace the file, or take it away",
    )

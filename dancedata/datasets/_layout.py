"""Small helpers of dataset readers for looking at a source folder and saying what is there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from dancedata.core.errors import SourceError
from dancedata.core.text import counted

__all__ = ["counted", "describe", "few", "list_folder", "read_names", "relative", "require_folder"]

SHOWN = 6
"""How many entries of a folder, or names of a list, a message shows."""
MAX_LIST_BYTES = 1 << 24
"""A list of names is never larger."""


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
    return few([*folders, *files]) if entries else "nothing"


def few(names: Sequence[str] | Iterable[str], shown: int = SHOWN) -> str:
    """Join the first names of a list and say how many more there are."""
    names = list(names)
    text = ", ".join(names[:shown])
    return text if len(names) <= shown else f"{text} and {len(names) - shown:,} more"


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
        If the file cannot be read or is not text.
    """
    try:
        with path.open("rb") as file:
            text = file.read(MAX_LIST_BYTES + 1)
        if len(text) > MAX_LIST_BYTES:
            raise OSError(f"more than {MAX_LIST_BYTES:,} bytes")
        lines = text.decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(
            "the list of names cannot be read",
            where=str(path),
            found=str(error),
            allowed="a UTF-8 text file, one name a line",
            fix="replace the file, or take it away",
        ) from error
    words = (line.split() for line in lines)
    return [parts[0] for parts in words if parts and not parts[0].startswith("#")]

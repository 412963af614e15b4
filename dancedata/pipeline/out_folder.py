"""The folder that a build writes: locked, looked at, filled or swapped; nothing of others is touched.

Beside OUT there may be, of a build that is running or was killed::

    .dancedata-NAME.lock              held by the build that is writing
    .dancedata-NAME.new-<8 digits>    the dataset that will replace OUT
    .dancedata-NAME.old-<8 digits>    the dataset that was replaced

A dataset is known by its dataset.json, which lists its files; the folder of an unfinished one by a marker in it.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

from dancedata.core.errors import StoreError
from dancedata.core.text import listed
from dancedata.files.locks import writing_lock
from dancedata.files.regular_file import sha256_file
from dancedata.files.staging import MARKER, Layout, discard, staged, tidy
from dancedata.files.strict_json import read_json
from dancedata.files.swap import Swap
from dancedata.store.dataset_json import MAX_BYTES, Description, load_description, self_hash
from dancedata.store.schema import (
    CARD_FILE,
    DATASET_FILE,
    QUALITY_FILE,
    REJECTS_FILE,
    STATS_FILE,
    is_shard_name,
)

_SIDE_FILES = {STATS_FILE, REJECTS_FILE, QUALITY_FILE, CARD_FILE}
_log = logging.getLogger(__name__)


def _is_own(name: str) -> bool:
    return name == DATASET_FILE or name in _SIDE_FILES or is_shard_name(name)


def _is_whole(path: Path) -> bool:
    try:
        if path.is_symlink():
            return False
        document = read_json(path, MAX_BYTES)
        return isinstance(document, dict) and document.get("self_sha256") == self_hash(document)
    except (OSError, ValueError):
        return False


LAYOUT = Layout(DATASET_FILE, _is_whole, _is_own)


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Make `out` and hold its lock; a second writer fails at once. What killed builds left is put right first."""
    created = not out.exists()
    with ExitStack() as stack:
        with _writing(out):
            out.resolve().parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(writing_lock(out, "build"))
            _SWAP.put_right(out)
            out.mkdir(exist_ok=True)
            if created:
                stack.callback(_remove_empty, out)
            tidy(out, LAYOUT)
            _SWAP.tidy(out)
        yield


@contextmanager
def _writing(out: Path) -> Iterator[None]:
    """Turn errors of the file system into one that names the output folder."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            "the output folder cannot be written",
            where=out,
            found=str(error),
            fix="choose an --out that is a folder of your own, on a disk with room",
        ) from error


def check_out(out: Path, *, overwrite: bool) -> None:
    """Raise StoreError if the folder holds files that no build wrote, or with `overwrite` a card that was changed."""
    names = sorted(p.name for p in out.iterdir())
    description = _described(out) if DATASET_FILE in names else None
    listed_files = set() if description is None else _files_of(description)
    foreign = [name for name in names if name not in listed_files]
    if foreign:
        leftovers = "" if description is not None or not any(map(is_shard_name, foreign)) else _LEFTOVERS
        raise StoreError(
            "the output folder holds files that are not dancedata's",
            where=out,
            found=listed(foreign),
            allowed="an empty folder, a new one, or a dataset built before",
            fix=f"choose another --out, or move them away; nothing was written{leftovers}",
        )
    card = description.files.get(CARD_FILE) if description is not None and overwrite else None
    if card is not None and (out / CARD_FILE).exists() and sha256_file(out / CARD_FILE) != card["sha256"]:
        raise StoreError(
            f"{CARD_FILE} was changed since the dataset was built, and --overwrite would remove it",
            where=out,
            fix=f"move {CARD_FILE} to another folder, then run the same command again",
        )


_LEFTOVERS = ". If an interrupted build of an earlier version left them, remove the folder"


def _described(out: Path) -> Description:
    """Read the dataset.json of a folder that is not empty; StoreError if another program wrote it."""
    try:
        return load_description(out)
    except StoreError as error:
        raise StoreError(
            "the output folder holds a dataset.json that dancedata cannot read as its own; nothing was written",
            where=out,
            found=str(error),
            allowed="an empty folder, a new one, or a dataset built before",
            fix="choose another --out; if this is a dataset that is damaged, remove the folder, then build again",
        ) from error


def _files_of(description: Description) -> set[str]:
    """Return the names that a dataset's files have."""
    return {DATASET_FILE, *(shard.file for shard in description.shards), *(_SIDE_FILES & set(description.files))}


@contextmanager
def new_dataset(out: Path) -> Iterator[Path]:
    """Give a folder to write a dataset to; on success it becomes that of `out`, or replaces the one there.

    On any exception it is removed, and `out` stays as it was.

    Raises
    ------
    StoreError
        If by now `out` holds a file that would be replaced, or nothing can be written.
    """
    with _writing(out):
        replaces = (out / DATASET_FILE).exists()
        check = partial(check_out, out, overwrite=True)
        with _SWAP.swapped(out, check) if replaces else staged(out, LAYOUT) as folder:
            yield folder


def _remove(folder: Path) -> None:
    """Remove a folder of a swap: the files of the dataset, or of the unfinished one, and nothing else in it."""
    try:
        listed_files = _files_of(load_description(folder)) | {MARKER}
    except StoreError:
        discard(folder, LAYOUT)
    else:
        with suppress(OSError):
            for name in listed_files & set(os.listdir(folder)) - {DATASET_FILE}:
                (folder / name).unlink()
            if os.listdir(folder) == [DATASET_FILE]:  # else it goes on saying whose the folder is
                (folder / DATASET_FILE).unlink()
                folder.rmdir()
    if os.path.lexists(folder):
        _log.warning("%s is left: it holds something that is not of a dataset, or is in use", folder)


def _remove_empty(out: Path) -> None:
    with suppress(OSError):
        out.rmdir()


_SWAP = Swap("", lambda folder: _is_whole(folder / DATASET_FILE), _remove)

"""Lock, inspect, fill or swap the output folder of a build (`files.publish`); foreign files are never touched.

A dataset is recognised by its dataset.json, which lists its files.
"""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

from dancedata.core.errors import StoreError
from dancedata.core.hashing import self_hash
from dancedata.files.atomic import is_temporary
from dancedata.files.locks import writing_lock
from dancedata.files.publish import (
    MARKER,
    Layout,
    discard,
    foreign_files,
    new_folders,
    recover,
    staged,
    swapped,
    tidy,
    writable,
)
from dancedata.files.regular_file import sha256_file
from dancedata.files.strict_json import read_json
from dancedata.store.dataset_json import MAX_BYTES, Description, load_description
from dancedata.store.listed_file import hdf5_files
from dancedata.store.schema import CARD_FILE, DATASET_FILE, LOCAL_FILE, REJECTS_FILE, STATS_FILE, is_shard_name

_SIDE_FILES = {STATS_FILE, REJECTS_FILE, CARD_FILE, LOCAL_FILE}
_ALLOWED = "an empty folder, a new one, or a dataset built before"


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Make `out` and hold its lock; a second writer fails at once. Recovers from killed builds first."""
    with ExitStack() as stack:
        with _writing(out):
            out.resolve().parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(writing_lock(out, "build"))
            recover(out, _LAYOUT)
            stack.enter_context(new_folders(out))
            tidy(out, _LAYOUT)
        yield


def check_out(out: Path, *, overwrite: bool) -> None:
    """Raise StoreError if the folder holds files that no build wrote, or with `overwrite` a card that was changed."""
    names = sorted(p.name for p in out.iterdir())
    description = _described(out) if DATASET_FILE in names else None
    listed_files = set() if description is None else _files_of(description)
    foreign = [name for name in names if name not in listed_files]
    if foreign:
        raise foreign_files(out, foreign, allowed=_ALLOWED, choose="another --out")
    card = description.files.get(CARD_FILE) if description is not None and overwrite else None
    if card is not None and (out / CARD_FILE).exists() and sha256_file(out / CARD_FILE) != card["sha256"]:
        raise StoreError(f"{CARD_FILE} was changed since the dataset was built, and --overwrite would remove it",
                         where=out,
                         fix=f"move {CARD_FILE} to another folder, then run the same command again")  # fmt: skip


@contextmanager
def new_dataset(out: Path) -> Iterator[Path]:
    """Yield a folder to fill; it becomes `out`, or on any exception is removed, and `out` stays as it was."""
    with _writing(out):
        replaces = (out / DATASET_FILE).exists()
        check = partial(check_out, out, overwrite=True)
        with swapped(out, _LAYOUT, check) if replaces else staged(out, _LAYOUT) as folder:
            yield folder


def _writing(out: Path) -> AbstractContextManager[None]:
    return writable(
        out, "the output folder cannot be written", "choose an --out that you can write to, on a disk with free space"
    )


def _described(out: Path) -> Description:
    """Read the dataset.json of a folder that is not empty; StoreError if another program wrote it."""
    try:
        return load_description(out)
    except StoreError as error:
        raise StoreError("the folder holds a dataset.json that dancedata cannot read as its own; nothing was written",
                         where=out, found=str(error), allowed=_ALLOWED,
                         fix="choose another --out; if it is damaged, remove the folder") from error  # fmt: skip


def _files_of(description: Description) -> set[str]:
    """Return the names that a dataset's files have."""
    return {
        DATASET_FILE,
        LOCAL_FILE,
        *(e.file for e in hdf5_files(description)),
        *(_SIDE_FILES & set(description.files)),
    }


def _is_ours(name: str) -> bool:
    return name == DATASET_FILE or name in _SIDE_FILES or is_shard_name(name)


def _is_complete(path: Path) -> bool:
    try:
        document = None if path.is_symlink() else read_json(path, MAX_BYTES)
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and document.get("self_sha256") == self_hash(document)


def _erase(folder: Path) -> None:
    """Remove a folder of a swap: the files of the dataset, or of the unfinished one, and nothing else in it."""
    try:
        names = _files_of(load_description(folder)) | {MARKER}
    except StoreError:
        discard(folder, _LAYOUT)
        return
    with suppress(OSError):
        for name in set(os.listdir(folder)) - {DATASET_FILE}:
            if name in names or is_temporary(name):
                (folder / name).unlink()
        if os.listdir(folder) == [DATASET_FILE]:  # otherwise keep it as proof of ownership
            (folder / DATASET_FILE).unlink()
            folder.rmdir()


_LAYOUT = Layout(DATASET_FILE, _is_complete, _is_ours, _erase)

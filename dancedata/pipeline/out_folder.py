"""The folder that a build writes: locked, looked at, cleaned, swapped; nothing of others is touched."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from dancedata.core.errors import StoreError
from dancedata.store.schema import (
    CARD_FILE,
    DATASET_FILE,
    QUALITY_FILE,
    REJECTS_FILE,
    STATS_FILE,
    is_shard_name,
)

LOCK_FILE = ".lock"
_OWN_FILES = {DATASET_FILE, STATS_FILE, REJECTS_FILE, QUALITY_FILE, CARD_FILE, LOCK_FILE}


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Make `out` and hold its lock; a second writer fails at once."""
    with _writing(out):
        _recover(out)
    made = not out.exists()
    with _writing(out):
        out.mkdir(parents=True, exist_ok=True)
    lock = _held_lock(out, out)
    if (out / DATASET_FILE).exists():
        # What a swap left that was killed at its very end.
        for folder in _beside(out):
            shutil.rmtree(folder, ignore_errors=True)
    try:
        yield
    finally:
        # Unlinked while it is held: a finished dataset holds no stray file.
        with suppress(OSError):
            (out / LOCK_FILE).unlink()
        lock.release()
        if made:
            with suppress(OSError):
                out.rmdir()  # which fails unless nothing was built


def _held_lock(folder: Path, out: Path) -> FileLock:
    """Take the lock in a folder; StoreError at once if another build has it."""
    lock = FileLock(folder / LOCK_FILE, timeout=0)
    with _writing(out):
        try:
            lock.acquire()
        except Timeout as error:
            raise StoreError(
                "another build is writing there", where=out, fix="wait until it has ended, or choose another --out"
            ) from error
    return lock


@contextmanager
def _writing(out: Path) -> Iterator[None]:
    """Turn errors of the file system into one that names the output folder."""
    try:
        yield
    except OSError as error:
        raise _unwritable(out, error) from error


def _unwritable(out: Path, error: OSError) -> StoreError:
    return StoreError(
        "the output folder cannot be written",
        where=out,
        found=str(error),
        fix="choose an --out that is a folder of your own, on a disk with room",
    )


def check_out(out: Path) -> None:
    """Raise StoreError if the folder holds files that no build wrote."""
    names = sorted(p.name for p in out.iterdir())
    # Shards are written first and removed last: a README.md alone is somebody else's.
    ours = any(name == DATASET_FILE or is_shard_name(name) for name in names)
    own = _OWN_FILES if ours else {LOCK_FILE}
    foreign = [n for n in names if n not in own and not is_shard_name(n) and not _is_temporary(n)]
    if foreign:
        shown = ", ".join(foreign[:5]) + (", ..." if len(foreign) > 5 else "")
        raise StoreError(
            "the output folder holds files that are not dancedata's",
            where=out,
            found=shown,
            allowed="an empty folder, a new one, or a dataset built before",
            fix="choose another --out; nothing was written",
        )


def _is_temporary(name: str) -> bool:
    """Tell whether a file is one that `atomic_file` was writing when it was killed."""
    return name.startswith(".") and name.endswith(".tmp")


def clean(out: Path) -> None:
    """Remove what a killed build left: without dataset.json none of it counts."""
    with _writing(out):
        for path in sorted(out.iterdir(), key=lambda p: is_shard_name(p.name)):
            if path.name != LOCK_FILE:
                path.unlink()
        for folder in _beside(out):
            shutil.rmtree(folder, ignore_errors=True)


def _beside(out: Path) -> tuple[Path, Path]:
    """Return the folders of a swap: the new dataset before it, the old one after it."""
    real = out.resolve()
    return real.parent / f".{real.name}.new", real.parent / f".{real.name}.old"


def _recover(out: Path) -> None:
    """Put the old dataset back where a swap was killed half way."""
    fresh, old = _beside(out)
    if out.exists() or not (old / DATASET_FILE).exists():
        return
    # The lock of a swap lies in all of its folders: a build that is alive is left to it.
    lock = _held_lock(old, out)
    try:
        os.rename(old, out)
        shutil.rmtree(fresh, ignore_errors=True)
    finally:
        lock.release()


@contextmanager
def swapped(out: Path) -> Iterator[Path]:
    """Give a fresh folder beside `out`; on success it takes its place."""
    fresh, old = _beside(out)
    with _writing(out):
        for folder in (fresh, old):
            shutil.rmtree(folder, ignore_errors=True)
        fresh.mkdir()
    try:
        yield fresh
        with _writing(out):
            real = out.resolve()
            # The same lock in the new folder, so that no second writer gets in between; not every file system
            # knows hard links.
            with suppress(OSError):
                os.link(real / LOCK_FILE, fresh / LOCK_FILE)
            os.rename(real, old)
            os.rename(fresh, real)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    shutil.rmtree(old, ignore_errors=True)

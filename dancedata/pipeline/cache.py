"""The content-addressed cache: every unit of work once, whatever build or training job asks for it."""

from __future__ import annotations

import math
import mmap
import os
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from stat import S_ISLNK
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import json_sha256, sha256_file
from dancedata.pipeline import cache_files as files

ENVIRONMENT = "DANCEDATA_CACHE"
#: What took longer than this to compute is flushed to disk before it appears in the cache.
DURABLE_FROM_S = 0.5


def default_cache() -> Path:
    """Return $DANCEDATA_CACHE, else dancedata's folder in the user's cache folder; UsageError if there is none."""
    named = os.environ.get(ENVIRONMENT)
    path = Path(named) if named else Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "dancedata"
    try:
        # No shell has expanded it where a job script or a container sets it.
        return path.expanduser()
    except RuntimeError as error:
        raise UsageError(
            "the home folder of the cache is not known", found=path, fix=f"set {ENVIRONMENT} to a folder, or --cache"
        ) from error


@lru_cache
def package_version(name: str) -> str:
    """Return the version of an installed distribution."""
    return version(name)


class EntryLostError(StoreError):
    """An entry of the cache that was there is gone or damaged; computing again puts it right."""


@dataclass(frozen=True)
class CachedArray:
    """An array in the cache, read when numpy asks for it.

    Attributes
    ----------
    path
        An entry: a .npy file with a checksum after its last value.
    shape
        Shape of the array that is wanted.
    entries
        Numbers of the entries that are wanted, along the first axis; None: all.
    """

    path: Path
    shape: tuple[int, ...]
    entries: tuple[int, ...] | None = None

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Load the array, checksum compared.

        Raises
        ------
        EntryLostError
            If it is gone or damaged. A damaged entry is removed, so that it is computed again.
        """
        try:
            array = files.read_array(self.path)
        except FileNotFoundError:
            array = self._read_again()
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        return np.array(array if self.entries is None else array[list(self.entries)], dtype=dtype)

    def take(self, entries: tuple[int, ...]) -> CachedArray:
        """Return some entries along the first axis, in that order."""
        return CachedArray(self.path, (len(entries), *self.shape[1:]), entries)

    def mapped(self) -> npt.NDArray[Any]:
        """Return all of the entry as a read-only view of the file; EntryLostError as above, checksum unseen.

        It stays valid when the entry is removed from the cache, and `prune` leaves it alone as long as it lives.
        """
        try:
            with open(self.path, "rb") as file:
                # The map keeps the open file, and with it the mark.
                files.mark_in_use(file.fileno())
                shape, dtype, begin = files.read_head(file.fileno())
                data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        return np.frombuffer(data, dtype, math.prod(shape), begin).reshape(shape)

    def _read_again(self) -> npt.NDArray[Any]:
        """Read an entry that is not there, after a look into its folder.

        A network file system remembers for a while that a name was not there when it was last looked for; on
        another machine the entry was made since then. Listing its folder makes it look.
        """
        try:
            os.listdir(self.path.parent)
            return files.read_array(self.path)
        except (OSError, ValueError) as error:
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> EntryLostError:
        if isinstance(error, ValueError):
            self.path.unlink(missing_ok=True)
            problem = "an entry of the cache is damaged and was removed"
        else:
            problem = "an entry of the cache is gone"
        fix = "run the same command again, only this entry is computed anew"
        return EntryLostError(problem, where=self.path, found=str(error), fix=fix)


@dataclass(frozen=True)
class Cache:
    """Arrays and small JSON under keys that say all that shaped them.

    Many processes on many machines may share a cache: an entry appears whole or not at all, two writers of one
    key write the same, and who wants an entry that another one is computing waits for it (`once`). Every entry
    carries a checksum, which is compared when it is read.

    Attributes
    ----------
    root
        The folder.
    careful
        Whether arrays are compared with their checksums when they are looked up: a damaged one counts as missing.
    """

    root: Path
    careful: bool = False

    @staticmethod
    def key(stage: str, **what: Any) -> str:
        """Return the key of a unit of work: a hash of its stage and of all that shapes its result."""
        return json_sha256({"stage": stage, **what})

    def array(self, stage: str, key: str) -> CachedArray | None:
        """Return an array if it is there and as long as it should be; its bytes are compared when it is read.

        They are compared now if the cache is `careful`.
        """
        path = self._name(stage, key, "npy")
        try:
            fd = os.open(path, os.O_RDONLY)
        except OSError:
            return None
        try:
            shape, _, _ = files.read_head(fd)
            used = os.fstat(fd).st_mtime
            if self.careful:
                files.read_array(Path(path))
        except (OSError, ValueError):
            # Damaged, which is a disk's doing: it counts as missing and is made again.
            return None
        finally:
            os.close(fd)
        files.note_use(path, used)
        return CachedArray(Path(path), shape)

    def put_array(self, stage: str, key: str, array: npt.NDArray[Any], *, durable: bool = True) -> CachedArray:
        """Publish an array; if `durable`, it is flushed to disk first."""
        path = self._path(stage, key, "npy")
        with _clear_errors(self.root):
            files.publish(self.root, path, files.array_parts(array), durable=durable)
        return CachedArray(path, array.shape)

    def once(self, stage: str, key: str, compute: Callable[[], npt.NDArray[Any]]) -> CachedArray:
        """Return an array, computed only if it is not there and nobody else is computing it."""
        found = self.array(stage, key)
        if found is not None:
            return found
        with self.lock(stage, key):
            found = self.array(stage, key)
            if found is None:
                started = time.monotonic()
                array = compute()
                found = self.put_array(stage, key, array, durable=time.monotonic() - started > DURABLE_FROM_S)
        return found

    @contextmanager
    def lock(self, stage: str, key: str) -> Iterator[None]:
        """Hold the lock of a unit of work while computing it; waits for whoever holds it.

        A process that dies gives its locks back. What is held here is worth looking for again in the cache: who
        had the lock before may have published it.
        """
        with entered(self.root, files.held(self.root / files.LOCKS, f"{stage}-{key}")):
            yield

    def json(self, stage: str, key: str) -> Any | None:
        """Return JSON data if it is there."""
        path = self._name(stage, key, "json")
        try:
            found, used = files.read_json(path)
        except (OSError, ValueError):
            # As above. Where the cache as a whole is no good, writing to it says so.
            return None
        files.note_use(path, used)
        return found

    def put_json(self, stage: str, key: str, obj: Any) -> None:
        """Publish JSON data."""
        with _clear_errors(self.root):
            files.publish(self.root, self._path(stage, key, "json"), files.json_parts(obj), durable=False)

    def holds(self, stage: str, key: str, suffix: str = "npy") -> bool:
        """Tell whether an entry is there, for those who do not want it; its bytes are not looked at."""
        return self._path(stage, key, suffix).exists()

    def file_sha256(self, path: Path) -> str:
        """Return the SHA-256 of a file's bytes, remembered as long as `stat_key` stays the same."""
        return self.known_sha256(path) or self.hashed_sha256(path)

    def hashed_sha256(self, path: Path) -> str:
        """Return the SHA-256 of a file's bytes, read now, and remember it."""
        key = self.stat_key("sha256", path)
        found = sha256_file(path)
        if self.stat_key("sha256", path) == key:  # else it changed meanwhile, and is somebody's to find out
            self.put_json("files", key, found)
        return found

    def known_sha256(self, path: Path) -> str | None:
        """Return what `file_sha256` remembers of a file, None if it would have to read it."""
        known = self.json("files", self.stat_key("sha256", path))
        return None if known is None else str(known)

    @staticmethod
    def stat_key(what: str, path: Path) -> str:
        """Return a key that changes when the file at `path` does: its path, size, inode and times of change.

        The time of a file's last change (ctime) is set by the system alone; that of its content can be set to any
        value, and programs that unpack or copy files do so.
        """
        stat = path.lstat()
        if S_ISLNK(stat.st_mode):
            path = Path(os.path.realpath(path))
            stat = path.stat()
        folder, name = os.path.split(path)
        real = f"{_real_folder(folder)}{os.sep}{name}"
        identity = [real, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino]
        return Cache.key("files", what=what, file=identity)

    def _path(self, stage: str, key: str, suffix: str) -> Path:
        return Path(self._name(stage, key, suffix))

    def _name(self, stage: str, key: str, suffix: str) -> str:
        return f"{self.root}{os.sep}{stage}{os.sep}{key[:2]}{os.sep}{key}.{suffix}"


@lru_cache(maxsize=1024)
def _real_folder(folder: str) -> str:
    # Many files lie in few folders. Where a link in their path is changed, files have other inodes.
    return os.path.realpath(folder)


@contextmanager
def entered(root: Path, context: AbstractContextManager[Any]) -> Iterator[None]:
    """Enter a context, with the errors of entering it made clear; not those of what is done within."""
    with _clear_errors(root):
        context.__enter__()
    try:
        yield
    finally:
        context.__exit__(None, None, None)


class _clear_errors:  # noqa: N801
    """Turn errors of the file system into one that names the cache."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, OSError):
            raise StoreError(
                "the cache cannot be written",
                where=self.root,
                found=str(error),
                fix=f"set {ENVIRONMENT} to a folder that is writable and has room",
            ) from error

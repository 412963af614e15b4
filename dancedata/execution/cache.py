"""The content-addressed cache: each unit of work is computed once for all builds and training jobs."""

from __future__ import annotations

import math
import mmap
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from stat import S_ISLNK
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import folder_of
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import json_sha256
from dancedata.core.packages import package_version
from dancedata.core.system import open_file
from dancedata.execution.arithmetic import expected
from dancedata.execution.progress import Progress
from dancedata.files import cache_files as files
from dancedata.files.regular_file import sha256_file

ENVIRONMENT = "DANCEDATA_CACHE"
#: Results that took longer than this to compute are flushed to disk before they appear in the cache.
DURABLE_FROM_S = 0.5
#: Number of times that a build starts again because entries were removed or damaged while it ran.
_LOST_ENTRIES = 3

T = TypeVar("T")


def default_cache() -> Path:
    """Return $DANCEDATA_CACHE, else `user_cache`; UsageError if the home folder that it begins with is unknown."""
    named = os.environ.get(ENVIRONMENT)
    return _expanded(Path(named)) if named else user_cache()


def user_cache() -> Path:
    """Return dancedata's folder in the user's cache folder; UsageError if there is none."""
    # Not platformdirs: it ignores a relative $XDG_CACHE_HOME, which would move existing caches.
    return _expanded(Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "dancedata")


def _expanded(path: Path) -> Path:
    try:
        # No shell has expanded it where a job script or a container sets it.
        return path.expanduser()
    except RuntimeError as error:
        raise UsageError(
            "the home folder of the cache is unknown", found=path, fix=f"set {ENVIRONMENT} to a folder, or --cache"
        ) from error


class EntryLostError(StoreError):
    """An entry of the cache that existed is missing or damaged; it has to be computed again."""


@dataclass(frozen=True)
class CachedArray:
    """An array in the cache, read when it is converted to a numpy array: a .npy file with a checksum at its end."""

    path: Path
    shape: tuple[int, ...]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Load the array and compare its checksum; EntryLostError if it is missing or damaged, which is removed."""
        try:
            try:
                array = files.read_array(self.path)
            except FileNotFoundError:
                # A network file system caches for a while that a name does not exist, although another machine has
                # made the entry. Listing the folder updates that cache.
                os.listdir(self.path.parent)
                array = files.read_array(self.path)
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        return np.asarray(array, dtype=dtype)

    def mapped(self) -> npt.NDArray[Any]:
        """Return the whole entry as a read-only view of the file, which `prune` then keeps; compares no checksum."""
        try:
            with open(self.path, "rb") as file:
                # The map keeps the file open, and with it the mark.
                files.mark_in_use(file.fileno())
                shape, dtype, begin = files.read_head(file.fileno())
                data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        return np.frombuffer(data, dtype, math.prod(shape), begin).reshape(shape)

    def _lost(self, error: Exception) -> EntryLostError:
        if isinstance(error, ValueError):
            self.path.unlink(missing_ok=True)
            problem = "an entry of the cache is damaged and was removed"
        else:
            problem = "an entry of the cache is gone"
        fix = "run the same command again: only this entry is computed again"
        return EntryLostError(problem, where=self.path, found=str(error), fix=fix)


@dataclass(frozen=True)
class Cache:
    """Arrays and small JSON documents in a folder, under keys that hash everything that shaped them.

    An entry appears whole or not at all, for processes on any machines that share the folder. Every entry has a
    checksum, which is compared when it is read; if the cache is `careful`, when it is looked up.
    """

    root: Path
    careful: bool = False

    @classmethod
    def at(cls, folder: str | Path | None = None) -> Cache:
        """Return the cache of a folder; default: `default_cache`."""
        return cls((folder_of(folder) or default_cache()).absolute())

    @staticmethod
    def numeric_key(stage: str, **what: Any) -> str:
        """Return the key of numbers that numpy and scipy compute: their versions and the instructions shape them."""
        packages = {name: package_version(name) for name in ("numpy", "scipy")}
        return Cache.key(stage, packages=packages, arithmetic=expected(), **what)

    @staticmethod
    def key(stage: str, **what: Any) -> str:
        """Return the key of a unit of work: a hash of its stage and of everything that shapes its result."""
        return json_sha256({"stage": stage, **what})

    def array(self, stage: str, key: str) -> CachedArray | None:
        """Return an array if it exists and has the right length; None if not."""
        path = self._name(stage, key, "npy")
        try:
            fd = open_file(path, os.O_RDONLY)
        except OSError:
            return None
        try:
            shape, _, _ = files.read_head(fd)
            used = os.fstat(fd).st_mtime
            if self.careful:
                files.read_array(Path(path))
        except (OSError, ValueError):
            # Damaged, as by a disk: it counts as missing and is computed again.
            return None
        finally:
            os.close(fd)
        files.touch(path, used)
        return CachedArray(Path(path), shape)

    def put_array(self, stage: str, key: str, array: npt.NDArray[Any], *, durable: bool = True) -> CachedArray:
        """Publish an array; if `durable`, it is flushed to disk first."""
        path = self._path(stage, key, "npy")
        with _clear_errors(self.root):
            files.publish(self.root, path, files.array_parts(array), durable=durable)
        return CachedArray(path, array.shape)

    def once(self, stage: str, key: str, compute: Callable[[], npt.NDArray[Any]]) -> CachedArray:
        """Return an array; compute it if it does not exist and no other process is computing it."""
        entry = self.array(stage, key)
        if entry is not None:
            return entry
        with self.lock(stage, key):
            entry = self.array(stage, key)
            if entry is None:
                started = time.monotonic()
                array = compute()
                entry = self.put_array(stage, key, array, durable=time.monotonic() - started > DURABLE_FROM_S)
        return entry

    @contextmanager
    def lock(self, stage: str, key: str) -> Iterator[None]:
        """Hold the lock of a unit of work while it is computed; look for its entry again once it is held."""
        with ExitStack() as stack:
            with _clear_errors(self.root):  # of entering the context, not of what is done in it
                stack.enter_context(files.locked_file(self.root / files.LOCKS, f"{stage}-{key}"))
            yield

    def json(self, stage: str, key: str) -> Any | None:
        """Return JSON data, None if it does not exist."""
        path = self._name(stage, key, "json")
        try:
            content, used = files.read_json(path)
        except (OSError, ValueError):
            # As above. If the whole cache cannot be used, writing to it raises.
            return None
        files.touch(path, used)
        return content

    def put_json(self, stage: str, key: str, obj: Any) -> None:
        """Publish JSON data."""
        with _clear_errors(self.root):
            files.publish(self.root, self._path(stage, key, "json"), files.json_parts(obj), durable=False)

    def contains(self, stage: str, key: str, suffix: str = "npy") -> bool:
        """Return whether an entry exists, without reading it or noting a use."""
        return self._path(stage, key, suffix).exists()

    def file_sha256(self, path: Path) -> str:
        """Return the SHA-256 of a file's bytes, remembered as long as `stat_key` stays the same."""
        return self.cached_sha256(path) or self.hashed_sha256(path)

    def hashed_sha256(self, path: Path) -> str:
        """Return the SHA-256 of a file's bytes, read now, and remember it."""
        key = self.stat_key("sha256", path)
        sha256 = sha256_file(path)
        if self.stat_key("sha256", path) == key:  # if the file changed while hashing, the caller detects it
            self.put_json("files", key, sha256)
        return sha256

    def cached_sha256(self, path: Path) -> str | None:
        """Return the SHA-256 that `file_sha256` has stored for a file, None if it would have to read the file."""
        sha256 = self.json("files", self.stat_key("sha256", path))
        return None if sha256 is None else str(sha256)

    @staticmethod
    def stat_key(what: str, path: Path) -> str:
        """Return a key that changes when a file does: path, size, inode and times; only the system sets ctime."""
        stat = path.lstat()
        if S_ISLNK(stat.st_mode):
            path = Path(os.path.realpath(path))
            stat = path.stat()
        folder, name = os.path.split(path)
        real = f"{_real_folder(folder)}{os.sep}{name}"
        identity = [real, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino]
        return Cache.key("files", what=what, file=identity)

    def retry_lost(self, run: Callable[[Cache], T], progress: Progress) -> T:
        """Run a build, and run it again if an entry of the cache is lost; EntryLostError where that does not help.

        After the first mismatch, checksums of all entries are compared when they are looked up.
        """
        cache = self
        for _ in range(_LOST_ENTRIES):
            try:
                return run(cache)
            except EntryLostError as error:
                progress.write(f"{error.where}: {error.problem}; all entries are compared with their checksums now")
                cache = replace(cache, careful=True)
        return run(cache)

    def _path(self, stage: str, key: str, suffix: str) -> Path:
        return Path(self._name(stage, key, suffix))

    def _name(self, stage: str, key: str, suffix: str) -> str:
        return f"{self.root}{os.sep}{stage}{os.sep}{key[:2]}{os.sep}{key}.{suffix}"


@lru_cache(maxsize=1024)
def _real_folder(folder: str) -> str:
    # Many files share a few folders. If a link in their path changes, the files have other inodes.
    return os.path.realpath(folder)


@contextmanager
def _clear_errors(root: Path) -> Iterator[None]:
    """Raise an error that names the cache instead of an OSError."""
    try:
        yield
    except OSError as error:
        raise StoreError("the cache cannot be written", where=root, found=str(error),
                         fix=f"set {ENVIRONMENT} to a writable folder with free space") from error  # fmt: skip

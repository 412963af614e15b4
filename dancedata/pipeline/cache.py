"""The content-addressed cache: every unit of work once, whatever build or training job asks for it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.atomic import atomic_file, write_json
from dancedata.core.errors import StoreError
from dancedata.core.hashing import json_sha256, sha256_file

ENVIRONMENT = "DANCEDATA_CACHE"


def default_cache() -> Path:
    """Return $DANCEDATA_CACHE, else dancedata's folder in the user's cache folder."""
    named = os.environ.get(ENVIRONMENT)
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dancedata"


@lru_cache
def package_version(name: str) -> str:
    """Return the version of an installed distribution."""
    return version(name)


@dataclass(frozen=True)
class CachedArray:
    """An array in the cache, read when numpy asks for it.

    Attributes
    ----------
    path
        A .npy file.
    shape
        Shape of the array that is wanted.
    entries
        Numbers of the entries that are wanted, along the first axis; None: all.
    """

    path: Path
    shape: tuple[int, ...]
    entries: tuple[int, ...] | None = None

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Load the array."""
        array = np.load(self.path, mmap_mode="r", allow_pickle=False)
        return np.array(array if self.entries is None else array[list(self.entries)], dtype=dtype)

    def take(self, entries: tuple[int, ...]) -> CachedArray:
        """Return some entries along the first axis, in that order."""
        return CachedArray(self.path, (len(entries), *self.shape[1:]), entries)


@dataclass(frozen=True)
class Cache:
    """Arrays and small JSON under keys that say all that shaped them.

    Entries are published atomically (temporary file, fsync, rename), so that many processes may share a
    cache: a reader finds a whole entry or none, and two writers of one key write the same.
    """

    root: Path

    @staticmethod
    def key(stage: str, **what: Any) -> str:
        """Return the key of a unit of work: a hash of its stage and of all that shapes its result."""
        return json_sha256({"stage": stage, **what})

    def array(self, stage: str, key: str) -> CachedArray | None:
        """Return an array if it is there."""
        path = self._path(stage, key, "npy")
        try:
            shape = np.load(path, mmap_mode="r", allow_pickle=False).shape
        except (OSError, ValueError):
            # A damaged entry (a disk's doing: ours are published whole) counts as missing and is made again.
            return None
        return CachedArray(path, tuple(int(n) for n in shape))

    def put_array(self, stage: str, key: str, array: npt.NDArray[Any]) -> CachedArray:
        """Publish an array."""
        path = self._path(stage, key, "npy")
        with _clear_errors(self.root), atomic_file(_parent_made(path)) as temporary, open(temporary, "wb") as file:
            np.save(file, np.ascontiguousarray(array), allow_pickle=False)
        return CachedArray(path, array.shape)

    def json(self, stage: str, key: str) -> Any | None:
        """Return JSON data if it is there."""
        try:
            return json.loads(self._path(stage, key, "json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            # As above. Where the cache as a whole is no good, writing to it says so.
            return None

    def put_json(self, stage: str, key: str, obj: Any) -> None:
        """Publish JSON data."""
        with _clear_errors(self.root):
            write_json(_parent_made(self._path(stage, key, "json")), obj)

    def file_sha256(self, path: Path) -> str:
        """Return the SHA-256 of a file's bytes, remembered by path, size, time of change and inode."""
        key = self.stat_key("sha256", path)
        known = self.json("files", key)
        if known is None:
            known = sha256_file(path)
            self.put_json("files", key, known)
        return str(known)

    @staticmethod
    def stat_key(what: str, path: Path) -> str:
        """Return a key that changes when the file at `path` does."""
        stat = path.stat()
        identity = [str(path.resolve()), stat.st_size, stat.st_mtime_ns, stat.st_ino]
        return Cache.key("files", what=what, file=identity)

    def _path(self, stage: str, key: str, suffix: str) -> Path:
        return self.root / stage / key[:2] / f"{key}.{suffix}"


def _parent_made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


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

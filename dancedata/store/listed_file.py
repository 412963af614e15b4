"""Files that dataset.json lists, recognised when they are opened later: a dataset may have been rebuilt since."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.errors import StoreError
from dancedata.core.hashing import sha256_bytes
from dancedata.core.system import open_file
from dancedata.files.addresses import origin_of, require_file
from dancedata.files.cache_files import mark_in_use
from dancedata.files.listing import FileEntry
from dancedata.files.regular_file import read_regular, sha256_file
from dancedata.store.dataset_json import REBUILD, Description, load_description, require_sealed
from dancedata.store.schema import DATASET_FILE, SEGMENTS_FILE, TABLES_FILE

#: Gives the SHA-256 of a file, such as `Cache.file_sha256`, which remembers it.
FileHash = Callable[[Path], str]
_DAMAGED = f"copy the whole folder again, or {REBUILD} with --overwrite"
#: Least time between two looks at an open file, seconds.
_PAUSE_S = 0.01
#: Number of times that a folder is read while it is being replaced.
_TRIES = 3


@dataclass(frozen=True)
class FileId:
    """Identity of a file and its content; with times of change, as the inode of a removed file may be reused."""

    device: int
    inode: int
    size: int
    modified_ns: int
    changed_ns: int

    @classmethod
    def of(cls, status: os.stat_result) -> FileId:
        """Make it from the result of os.stat."""
        return cls(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)

    def same_file(self, other: FileId) -> bool:
        """Whether both are the same file, changed or not."""
        return (self.device, self.inode) == (other.device, other.inode)


class ListedFile:
    """A file as dataset.json listed it when the dataset was opened; without `status` it is fetched later."""

    def __init__(
        self, path: Path, size: int, sha256: str, status: os.stat_result | None, *, fetched: bool = False
    ) -> None:
        self.path = path
        self._size, self._sha256 = size, sha256
        self._id = None if status is None else FileId.of(status)
        self.is_fetched = fetched
        self._next_look = 0.0

    def require(self, descriptor: int) -> None:
        """Raise StoreError unless an open file is the one listed, or one that still has its size and bytes."""
        opened = FileId.of(os.fstat(descriptor))
        if self._id is None and opened.size == self._size:
            self._id = opened  # its bytes were compared when they arrived
        if opened == self._id:
            return
        if not self._is_still_listed() or _identity(self.path) != opened:
            raise self._rebuilt_error()
        # A file that was truncated in place is an error later, where bytes are missing.
        before = self._id
        if opened.size != self._size and (before is None or not opened.same_file(before)):
            raise _another_size(self.path, opened.size, self._size)
        if before is not None and opened.same_file(before):
            self.require_bytes(sha256_file)  # touched, linked, or overwritten in place
        self._id = opened

    def require_unchanged(self, *, again: bool = False) -> None:
        """Raise StoreError if the file that was opened was written to since then, and has other bytes now.

        Asks the system at most every 10 ms: reading a window takes no longer than asking a few times. With `again` it
        is asked before rows are read, and will be once more after that.
        """
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = self._next_look if again else now + _PAUSE_S
        present = _identity(self.path)
        opened = self._id
        if opened is None or present is None or present == opened or not present.same_file(opened):
            return  # one that was removed or replaced has its bytes as long as it is open
        self.require_bytes(sha256_file)  # the time of change cannot be put back; that of the content can
        self._id = present

    def open(self) -> int:
        """Open the file for reading and return its descriptor; StoreError unless it is the one listed."""
        self.ensure_local()
        try:
            descriptor = open_file(self.path, os.O_RDONLY)
        except OSError as error:
            raise StoreError(
                f"{_part(self.path)} cannot be opened", where=str(self.path), found=str(error)
            ) from error
        try:
            self.require(descriptor)
            if self.is_fetched:
                mark_in_use(descriptor)  # `cache prune` keeps it
        except BaseException:
            os.close(descriptor)
            raise
        return descriptor

    def ensure_local(self) -> None:
        """Raise StoreError if the path does not exist any more or is not a file; fetch it if it is of an address."""
        if self.is_fetched:
            require_file(self.path)
        try:
            mode = os.stat(self.path).st_mode
        except OSError:
            mode = None
        if mode is None and not self._is_still_listed():
            raise self._rebuilt_error()
        if mode is None or not stat.S_ISREG(mode):
            raise _missing(self.path, self._size)

    def require_bytes(self, sha256: FileHash) -> None:
        """Raise StoreError unless the file has the bytes that dataset.json lists, by `sha256` of a path."""
        if self.is_fetched:
            require_file(self.path)
        try:
            actual = sha256(self.path)
        except OSError as error:
            raise StoreError(f"{_part(self.path)} cannot be read", where=str(self.path), found=str(error)) from error
        if actual != self._sha256:
            raise other_bytes(self.path, actual, self._sha256) if self._is_still_listed() else self._rebuilt_error()

    def _is_still_listed(self) -> bool:
        try:
            return lists_file(load_description(self.path.parent), self.path.name, self._size, self._sha256)
        except StoreError:
            return False

    def _rebuilt_error(self) -> StoreError:
        return rebuilt_error(self.path.parent, f"{self.path.name} is not the file that was listed then")


def hdf5_files(description: Description) -> list[FileEntry]:
    """Return the entries of shards, tables and segments."""
    files = {name: description.files[name] for name in (TABLES_FILE, SEGMENTS_FILE) if name in description.files}
    return [*description.shards, *(FileEntry(name, entry["size"], entry["sha256"]) for name, entry in files.items())]


def lists_file(description: Description, name: str, size: int, sha256: str) -> bool:
    """Whether a dataset lists a file of this name, size and hash."""
    entries = {entry.file: (entry.size, entry.sha256) for entry in hdf5_files(description)}
    entries |= {file: (entry["size"], entry["sha256"]) for file, entry in description.files.items()}
    return entries.get(name) == (size, sha256)


def read_listed(folder: Path, description: Description, name: str, limit: int) -> str:
    """Read a side file, of at most `limit` bytes; StoreError if its bytes are not those that the build wrote."""
    entry = description.files.get(name)
    require_file(folder / name)
    try:
        data: bytes | None = read_regular(folder / name, limit)
    except FileNotFoundError as error:
        data, missing = None, error
    actual = None if data is None else sha256_bytes(data)
    if entry is not None and actual != entry["sha256"]:
        try:
            same = lists_file(load_description(folder), name, entry["size"], entry["sha256"])
        except StoreError:
            same = False
        if not same:
            raise rebuilt_error(folder, f"{name} is not the file that was listed then")
        if actual is not None:
            raise other_bytes(folder / name, actual, entry["sha256"])
    if data is None:
        raise missing
    return data.decode("utf-8")


def rebuilt_error(folder: Path, detail: str) -> StoreError:
    """Return the error of a reader whose dataset was replaced."""
    gone = "" if (folder / DATASET_FILE).exists() else "removed, or "
    return StoreError(f"the dataset was {gone}built again since it was opened", where=str(folder), found=detail,
                      fix="open it again; values that were read before belong to the old dataset")  # fmt: skip


def open_listed(folder: Path) -> tuple[Description, Mapping[str, ListedFile]]:
    """Read dataset.json and find shards, tables and segments, by name, all of the same dataset; else StoreError."""
    for _ in range(_TRIES):
        before = _identity(folder / DATASET_FILE)
        try:
            description = load_description(folder)
            require_sealed(description, folder)
            remote = origin_of(folder) is not None
            files = {e.file: _listed(folder / e.file, e.size, e.sha256, remote) for e in hdf5_files(description)}
        except StoreError:
            if before == _identity(folder / DATASET_FILE):
                raise
        else:
            if before == _identity(folder / DATASET_FILE):
                return description, files
    raise StoreError("the dataset is being replaced", where=str(folder), fix="open it again after the build")


def _identity(path: Path) -> FileId | None:
    try:
        return FileId.of(os.stat(path))
    except OSError:
        return None


def _listed(path: Path, size: int, sha256: str, remote: bool) -> ListedFile:
    try:
        status = os.stat(path)
    except OSError:
        status = None
    if remote and status is None:
        return ListedFile(path, size, sha256, None, fetched=True)
    if status is None or not stat.S_ISREG(status.st_mode):
        raise _missing(path, size)
    if status.st_size != size:
        raise _another_size(path, status.st_size, size)
    return ListedFile(path, size, sha256, status, fetched=remote)


def _damaged(problem: str, path: Path, actual: str, expected: str) -> StoreError:
    return StoreError(problem, where=str(path), found=actual, allowed=expected, fix=_DAMAGED)


def other_bytes(path: Path, actual: str, expected: str) -> StoreError:
    """Return the error of a file whose SHA-256 is not that of dataset.json."""
    problem = f"the bytes of {path.name} are not those that the build wrote"
    return _damaged(problem, path, f"sha256 {actual[:12]}...", f"{expected[:12]}..., as in dataset.json")


def _part(path: Path) -> str:
    return f"the file of {path.stem}" if path.name in (TABLES_FILE, SEGMENTS_FILE) else "a shard"


def _missing(path: Path, size: int) -> StoreError:
    actual = "not a regular file" if path.exists() else "no such file"
    return _damaged(f"{_part(path)} is missing", path, actual, f"{size} bytes")


def _another_size(path: Path, actual: int, size: int) -> StoreError:
    return _damaged(f"the size of {_part(path)} differs from dataset.json", path, f"{actual} bytes", f"{size} bytes")

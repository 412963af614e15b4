"""Files of an open dataset: whatever is opened later is the very file that was described, or an error.

A reader opens shards late, by path, with tables and offsets that it has read before. Meanwhile the dataset may have
been built again in the same place.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.errors import StoreError
from dancedata.core.hashing import sha256_bytes
from dancedata.core.regular_file import read_regular
from dancedata.store.dataset_json import REBUILD, Description, load_description
from dancedata.store.schema import DATASET_FILE

_DAMAGED = f"copy the whole folder again, or {REBUILD} with --overwrite"
#: How often a folder is looked at again that is replaced in this moment.
_TRIES = 3


@dataclass(frozen=True)
class FileId:
    """What tells one file from another, and from itself after a change.

    Times of change are a part of it: the system gives the inode of a removed file to the next one.
    """

    device: int
    inode: int
    size: int
    modified_ns: int
    changed_ns: int

    @classmethod
    def of(cls, found: os.stat_result) -> FileId:
        """Take it from what stat gives."""
        return cls(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)

    def same_file(self, other: FileId) -> bool:
        """Tell whether both are one file, changed or not."""
        return (self.device, self.inode) == (other.device, other.inode)


class DescribedFile:
    """A file that dataset.json describes, as it was when the dataset was opened.

    Attributes
    ----------
    path
        Where it is.
    """

    def __init__(self, path: Path, size: int, sha256: str, seen: os.stat_result) -> None:
        """Remember the file; `seen` is what stat gave for it."""
        self.path = path
        self._size, self._sha256 = size, sha256
        self._known = FileId.of(seen)

    def require(self, descriptor: int) -> None:
        """Raise StoreError unless an open file is the one described.

        A file that was copied, moved or touched since then is compared by what dataset.json says now: that another
        file has the same size and SHA-256.
        """
        found = FileId.of(os.fstat(descriptor))
        if found == self._known:
            return
        if not self._still_described() or _identity(self.path) != found:
            raise self._built_again()
        # One that was cut short in place is found out where its bytes are missing.
        if found.size != self._size and not found.same_file(self._known):
            raise _another_size(self.path, found.size, self._size)
        self._known = found

    def open(self) -> int:
        """Open the file for reading and return its descriptor; StoreError unless it is the one described."""
        self.require_there()
        try:
            # Not blocking: what lies there now may be a named pipe.
            descriptor = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except OSError as error:
            raise StoreError("a shard cannot be opened", where=str(self.path), found=str(error)) from error
        try:
            self.require(descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        return descriptor

    def require_there(self) -> None:
        """Raise StoreError if there is no file any more, but nothing, or something that is not a file."""
        try:
            mode = os.stat(self.path).st_mode
        except OSError:
            mode = None
        if mode is None and not self._still_described():
            raise self._built_again()
        if mode is None or not stat.S_ISREG(mode):
            raise _missing(self.path, self._size)

    def _still_described(self) -> bool:
        try:
            return describes(load_description(self.path.parent), self.path.name, self._size, self._sha256)
        except StoreError:
            return False

    def _built_again(self) -> StoreError:
        return built_again(self.path.parent, f"{self.path.name} is not the file that was described then")


def describes(description: Description, name: str, size: int, sha256: str) -> bool:
    """Tell whether a dataset has a file of this name, size and hash."""
    listed = {shard.file: (shard.size, shard.sha256) for shard in description.shards}
    listed |= {file: (entry["size"], entry["sha256"]) for file, entry in description.files.items()}
    return listed.get(name) == (size, sha256)


def read_described(folder: Path, description: Description, name: str, limit: int) -> str:
    """Read a side file of an open dataset, such as stats.json, of at most `limit` bytes.

    One that was changed in its place is read as it is; `check` finds it.

    Raises
    ------
    StoreError
        If the dataset was built again, so that the file there belongs to another one.
    OSError, UnicodeDecodeError
        If it cannot be read.
    """
    entry = description.files.get(name)
    try:
        data: bytes | None = read_regular(folder / name, limit)
    except FileNotFoundError:
        data = None
    if entry is not None and (data is None or sha256_bytes(data) != entry["sha256"]):
        try:
            same = describes(load_description(folder), name, entry["size"], entry["sha256"])
        except StoreError:
            same = False
        if not same:
            raise built_again(folder, f"{name} is not the file that was described then")
    if data is None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder / name))
    return data.decode("utf-8")


def built_again(folder: Path, found: str) -> StoreError:
    """Return the error of a reader whose dataset was replaced."""
    gone = "" if (folder / DATASET_FILE).exists() else "removed, or "
    return StoreError(
        f"the dataset was {gone}built again since it was opened",
        where=str(folder),
        found=found,
        fix="open it again: what was read from it before does not belong to what is there now",
    )


def open_described(folder: Path) -> tuple[Description, Mapping[str, DescribedFile]]:
    """Read dataset.json and look at the shards, by name; all of them of one and the same dataset.

    Raises
    ------
    StoreError
        If there is no finished dataset, or a shard is missing or of another size.
    """
    for _ in range(_TRIES):
        before = _identity(folder / DATASET_FILE)
        try:
            description = load_description(folder)
            shards = {s.file: _shard(folder / s.file, s.size, s.sha256) for s in description.shards}
        except StoreError:
            if before == _identity(folder / DATASET_FILE):
                raise
        else:
            if before == _identity(folder / DATASET_FILE):
                return description, shards
    raise StoreError("the dataset is being replaced", where=str(folder), fix="open it again when the build has ended")


def _identity(path: Path) -> FileId | None:
    try:
        return FileId.of(os.stat(path))
    except OSError:
        return None


def _shard(path: Path, size: int, sha256: str) -> DescribedFile:
    try:
        found = os.stat(path)
    except OSError:
        found = None
    if found is None or not stat.S_ISREG(found.st_mode):
        raise _missing(path, size)
    if found.st_size != size:
        raise _another_size(path, found.st_size, size)
    return DescribedFile(path, size, sha256, found)


def _missing(path: Path, size: int) -> StoreError:
    return StoreError(
        "a shard is missing",
        where=str(path),
        found="something that is not a file" if path.exists() else "no such file",
        allowed=f"{size} bytes",
        fix=_DAMAGED,
    )


def _another_size(path: Path, found: int, size: int) -> StoreError:
    return StoreError(
        "a shard has another size than dataset.json says",
        where=str(path),
        found=f"{found} bytes",
        allowed=f"{size} bytes",
        fix=_DAMAGED,
    )

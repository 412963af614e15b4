"""Folders that appear whole, with a list of their files: exports, and what lies beside a page.

Written next to its place and renamed (`files.publish`); foreign files are never touched. A finished folder is
recognised by its export.json, which lists its files.
"""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from stat import S_ISREG
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError, UsageError, unwritable_name
from dancedata.core.hashing import self_hash, sha256_bytes
from dancedata.core.text import shown
from dancedata.files import publish
from dancedata.files.atomic import write_json
from dancedata.files.locks import writing_lock
from dancedata.files.publish import MARKER, Layout, discard, is_claimed, mark, new_folders, swapped, writable
from dancedata.files.regular_file import sha256_file
from dancedata.files.strict_json import read_json

#: The file of a finished export that describes it.
ABOUT = "export.json"
README = "README.md"
#: Largest export.json, bytes: some 250 a file.
MAX_BYTES = 1 << 30


@dataclass(frozen=True)
class WrittenFile:
    """Size in bytes and SHA-256 of a file."""

    size: int
    sha256: str


class AtomicFolder:
    """Writes files by their paths, each counted and hashed, in a folder that is renamed once it is complete.

    `path`: Folder that is written to.
    `final`: Absolute path that the folder will have.
    `link`: Whether a file with the bytes of an earlier one becomes a hard link of it.
    """

    def __init__(self, path: Path, final: Path, link: bool = False) -> None:
        self.path = path
        self.final = final
        self.files: dict[str, WrittenFile] = {}
        self.notes: list[str] = []
        self.linked = 0
        self._link = link
        self._by_hash: dict[WrittenFile, str] = {}

    def note(self, text: str) -> None:
        """Add a sentence for the user to the summary, README.md and export.json; each is kept once."""
        if text not in self.notes:
            self.notes.append(text)

    def make_folder(self, name: str) -> None:
        """Make a folder that may stay empty, which a loader lists."""
        self._place(name, is_file=False).mkdir(parents=True, exist_ok=True)

    def write_bytes(self, name: str, data: bytes | bytearray | memoryview) -> None:
        """Write a file."""
        place = self._place(name)
        written = WrittenFile(len(data), sha256_bytes(memoryview(data)))
        if not self._linked(place, written):
            place.write_bytes(data)
        self._keep(name, written)

    @contextmanager
    def open_file(self, name: str) -> Iterator[BinaryIO]:
        """Open a new file for writing in the context, for what is too large to be made as a whole."""
        place = self._place(name)
        with place.open("xb") as file:
            yield file
        self._keep(name, WrittenFile(place.stat().st_size, sha256_file(place)))

    def write_npy(self, name: str, array: npt.NDArray[Any]) -> None:
        """Write an array as .npy, in C order."""
        buffer = io.BytesIO()
        np.save(buffer, np.ascontiguousarray(array), allow_pickle=False)
        with buffer.getbuffer() as data:
            self.write_bytes(name, data)

    def write_npz(self, name: str, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Write arrays as .npz, not compressed; equal arrays give equal bytes."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays)
        with buffer.getbuffer() as data:
            self.write_bytes(name, data)

    def write_json(self, name: str, obj: Any) -> None:
        """Write indented JSON."""
        text = json.dumps(obj, indent=1, ensure_ascii=False, allow_nan=False)
        self.write_text(name, text + "\n")

    def write_text(self, name: str, text: str) -> None:
        r"""Write UTF-8 text; characters that are not valid Unicode are written as ``\udcff``."""
        self.write_bytes(name, text.encode("utf-8", "backslashreplace"))

    def write_pickle(self, name: str, obj: Any) -> None:
        """Write a pickle of arrays and plain containers that every numpy of Python 3.4 and later loads."""
        buffer = io.BytesIO()
        _Pickler(buffer, protocol=4).dump(obj)
        with buffer.getbuffer() as data:
            self.write_bytes(name, data)

    def copy_file(self, name: str, source: Path) -> None:
        """Copy a file, or make a hard link of it where links are requested and possible."""
        place = self._place(name)
        if not self._linked_to(place, source):
            shutil.copyfile(source, place)
        self._keep(name, WrittenFile(place.stat().st_size, sha256_file(place)))

    def finish(self, record: Mapping[str, Any]) -> None:
        """Write export.json, the last file: what the folder is, and the size and hash of its files."""
        files = {name: [file.size, file.sha256] for name, file in sorted(self.files.items())}
        listing = {**record, "files": files}
        write_json(self.path / ABOUT, {**listing, "self_sha256": self_hash(listing)})

    def _place(self, name: str, *, is_file: bool = True) -> Path:
        parts = PurePosixPath(name).parts
        if not parts or name.startswith("/") or ".." in parts or "\0" in name:
            raise UsageError("not a path below the folder of an export", found=shown(name))
        if name in self.files:
            raise UsageError("two files of an export have the same name", found=shown(name))
        place = self.path.joinpath(*parts)
        if is_file and os.path.lexists(place):
            raise UsageError(
                "two files of an export have names that this file system takes for the same",
                found=shown(name),
                fix="export to a file system that tells upper from lower case, or rename a clip",
            )
        if is_file:
            place.parent.mkdir(parents=True, exist_ok=True)
        return place

    def _keep(self, name: str, written: WrittenFile) -> None:
        self.files[name] = written
        self._by_hash.setdefault(written, name)

    def _linked(self, place: Path, written: WrittenFile) -> bool:
        same = self._by_hash.get(written)
        return same is not None and self._linked_to(place, self.path / same)

    def _linked_to(self, place: Path, other: Path) -> bool:
        if self._link:
            with suppress(OSError):  # another file system, or one without links: the file is written instead
                os.link(os.path.realpath(other), place)
                self.linked += 1
                return True
        return False


class _Pickler(pickle.Pickler):
    """Pickles arrays as calls of ``numpy.ndarray``.

    Pickles that numpy 2 makes by itself name modules that numpy before 1.26, which most trainers need, does not have.
    """

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, np.ndarray) and not obj.dtype.hasobject:
            data = np.ascontiguousarray(obj).reshape(-1).view(np.uint8)
            return np.ndarray, (obj.shape, obj.dtype.str, bytearray(data))
        return NotImplemented


def read_about(folder: Path) -> dict[str, Any] | None:
    """Read export.json of a finished export; None if it is missing or not of an export."""
    path = folder / ABOUT
    try:
        record = None if path.is_symlink() else read_json(path, MAX_BYTES)
    except (OSError, ValueError):
        return None
    if not isinstance(record, dict) or not isinstance(record.get("files"), dict):
        return None
    return record if record.get("self_sha256") == self_hash(record) else None


@contextmanager
def atomic_folder(out: Path, *, overwrite: bool, link: bool = False) -> Iterator[AtomicFolder]:
    """Yield a folder to fill; on success it becomes `out`. On any exception it is removed, and `out` stays as it was.

    `link`: Whether a file with the bytes of an earlier one becomes a hard link of it.
    """
    problem = "the folder of the export cannot be written"
    fix = "choose an --out that you can write to, on a disk with free space; nothing was left there"
    try:
        with writable(out, problem, fix), new_folders(out.parent), writing_lock(out, "export"):
            publish.recover(out, _LAYOUT)
            _check(out, overwrite)
            publish.tidy(out, _LAYOUT)
            with swapped(out, _LAYOUT, partial(_check, out, overwrite)) as new:
                yield AtomicFolder(new, out, link)
    except UnicodeEncodeError as error:
        raise unwritable_name(error) from error


def _check(out: Path, overwrite: bool) -> None:
    if not os.path.lexists(out):
        return
    if not out.is_dir():
        raise StoreError("the place of the export is not a folder", where=out, fix="choose another --out")
    if not any(out.iterdir()):
        return
    about = read_about(out)
    what, foreign = "no export wrote", sorted(p.name for p in out.iterdir())
    if about is not None:
        what, foreign = "were added or changed since it was exported", foreign_files(out, about["files"])
    if foreign:
        raise publish.foreign_files(out, foreign, problem=f"the output folder contains files that {what}",
                                    allowed="an empty folder, a new one, or with --overwrite an export made before",
                                    choose="another --out")  # fmt: skip
    if about is not None and not overwrite:
        raise StoreError("the folder holds an export already", where=out,
                         found=f"{about.get('target')} of {about.get('name')}",
                         fix="choose another --out, or replace it with --overwrite; nothing was written")  # fmt: skip


def foreign_files(folder: Path, files: Mapping[str, Any]) -> list[str]:
    """Return the files that export.json does not list or that have changed: by size, and by hash if newer."""
    finished = (folder / ABOUT).lstat().st_mtime_ns
    foreign = []
    for path in folder.rglob("*"):
        name, status = path.relative_to(folder).as_posix(), path.lstat()
        if name == ABOUT or (path.is_dir() and not path.is_symlink()):
            continue
        size, sha256 = files.get(name, (-1, ""))
        is_same = S_ISREG(status.st_mode) and status.st_size == size
        if is_same and (name == README or status.st_mtime_ns > finished):
            is_same = sha256_file(path) == sha256
        if not is_same:
            foreign.append(name)
    return sorted(foreign)


def remove_listed(folder: Path) -> None:
    """Remove an unfinished folder, or the listed files of an export; log a warning if something stays."""
    _LAYOUT.remove(folder)


def _erase(folder: Path) -> None:
    """Remove a folder; its proof goes last, so that the next export removes the rest left by a killed process."""
    about = read_about(folder)
    if not is_claimed(folder) and (about is None or foreign_files(folder, about["files"])):
        discard(folder, _LAYOUT)
        return
    with suppress(OSError):
        with suppress(OSError):  # on a full disk, export.json alone is the proof
            mark(folder)
        for path in sorted(folder.iterdir(), key=lambda path: (path.name == MARKER, path.name == ABOUT)):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
        folder.rmdir()


_LAYOUT = Layout(ABOUT, lambda path: read_about(path.parent) is not None, lambda _: False, _erase, "export-")

"""The folder that an export writes: files by their path in it, each counted and hashed."""

import io
import json
import os
import pickle
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.hashing import sha256_bytes
from dancedata.core.text import shown
from dancedata.files.regular_file import sha256_file


@dataclass(frozen=True)
class WrittenFile:
    """Size in bytes and SHA-256 of a file."""

    size: int
    sha256: str


class ExportFolder:
    """Writes the files of an export, in a folder that is renamed once it is complete.

    Parameters
    ----------
    path
        Folder that is written to.
    final
        Absolute path that the folder will have.
    link
        Whether a file with the bytes of an earlier one becomes a hard link of it.
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

    def _place(self, name: str, *, is_file: bool = True) -> Path:
        parts = PurePosixPath(name).parts
        if not parts or name.startswith("/") or ".." in parts or "\0" in name:
            raise UsageError("not a path below the folder of an export", found=shown(name))
        if name in self.files:
            raise UsageError("two files of an export have the same name", found=shown(name))
        place = self.path.joinpath(*parts)
        if is_file and os.path.lexists(place):
            raise UsageError(
                "two files of an export have names that are one on this file system",
                found=shown(name),
                fix="export to a file system that tells upper from lower case, or name the clips otherwise",
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

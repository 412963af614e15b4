"""The folder of an export: written next to its place and renamed (`files.publish`); foreign files are never touched.

A finished export is recognised by its export.json, which lists its files.
"""

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from stat import S_ISREG
from typing import Any

from dancedata.core.errors import StoreError, unwritable_name
from dancedata.core.hashing import self_hash
from dancedata.exports.base.folder import ExportFolder
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


def write_about(folder: ExportFolder, record: Mapping[str, Any]) -> None:
    """Write export.json, the last file of a folder: what it is, and the size and hash of its files."""
    files = {name: [file.size, file.sha256] for name, file in sorted(folder.files.items())}
    listing = {**record, "files": files}
    write_json(folder.path / ABOUT, {**listing, "self_sha256": self_hash(listing)})


@contextmanager
def new_export(out: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a folder to fill; on success it becomes `out`. On any exception it is removed, and `out` stays as it was.

    Raises StoreError: if `out` holds anything but an export that may be replaced, another export is writing there, or
        nothing can be written.
    """
    problem = "the folder of the export cannot be written"
    fix = "choose an --out that you can write to, on a disk with free space; nothing was left there"
    try:
        with writable(out, problem, fix), new_folders(out.parent), replaced_export(out, overwrite=overwrite) as new:
            yield new
    except UnicodeEncodeError as error:
        raise unwritable_name(error) from error


@contextmanager
def replaced_export(out: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a folder to fill as `new_export` does, but raise OSError where nothing can be written."""
    with writing_lock(out, "export"):
        publish.recover(out, _LAYOUT)
        _check(out, overwrite)
        publish.tidy(out, _LAYOUT)
        with swapped(out, _LAYOUT, partial(_check, out, overwrite)) as new:
            yield new


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
    """Return the files of a folder that its export.json does not list, or that have changed.

    A file of the listed size has not changed if it is not newer than export.json, which was written last; the hashes
    of the others are compared, and that of the README.
    """
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


def remove_export(folder: Path) -> None:
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

"""One file from a server to the disk: in parts that are kept, compared with its hash, and whole or not at all."""

import errno
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from dancedata.core.errors import StoreError
from dancedata.core.hashing import self_hash, sha256_bytes
from dancedata.core.system import flush_folder
from dancedata.core.text import size_text
from dancedata.files.cache_files import DATASETS, LOCKS, locked_file, mark_in_use
from dancedata.files.listing import FileEntry
from dancedata.files.strict_json import parse_json
from dancedata.kernel import DatasetFiles, Progress
from dancedata.remote.address import Address
from dancedata.remote.client import Client
from dancedata.remote.hub import HubClient
from dancedata.remote.source import Interrupted, OutOfRange, read_within, refused, steady

#: Failures in a row, each with fewer than NEW_BYTES, after which a file is given up: a server that sends a byte a
#: connection would otherwise be asked for years. Seconds to wait after the first failure, doubled each time.
ATTEMPTS, NEW_BYTES, WAIT_S = 6, 1000, 0.5
#: Waits longer than this are shown, seconds.
_SHOWN_S = 5.0
Report = Callable[[int], None]
T = TypeVar("T")


def source_of(address: Address) -> Client:
    """Return the client for an address; made by the process that uses it."""
    return HubClient(address) if address.scheme == "hf" else Client(address)


def resolved(address: Address) -> Address:
    """Return the address whose content does not change: for a branch, that of its commit."""
    return _persist(lambda: source_of(address).resolve(), str(address))


def fetch_description(
    source: Client, address: Address, name: str = DatasetFiles.DATASET
) -> tuple[bytes, Mapping[str, Any]]:
    """Return dataset.json or publication.json as bytes and parsed; StoreError unless its self_sha256 is right."""
    where = f"{address}/{name}"
    problem = ""
    for _ in range(2):
        data = read_small(source, name, where)
        try:
            document = parse_json(data.decode("utf-8"))
            stated, content = document["self_sha256"], self_hash(document)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            problem = f"{type(error).__name__}, {len(data):,} bytes"
            continue
        if stated == content:
            return data, document
        problem = f"self_sha256 {str(stated)[:12]}..., content {content[:12]}..."
    raise refused(
        f"this is not the {name} of a finished dataset", where, problem, "check the address, or upload it again"
    )


def read_small(source: Client, name: str, where: str) -> bytes:
    """Return the bytes of a file; StoreError if there are more than a description has."""
    too_large = refused(f"the file is larger than any {name}", name, f"more than {DatasetFiles.MAX_BYTES:,} bytes")
    # It is small: no ranges.
    return _persist(
        lambda: read_within(source.open(name, 0).chunks, DatasetFiles.MAX_BYTES, lambda _: too_large), where
    )


def fetch_file(source: Client, address: Address, file: FileEntry, folder: Path, report: Report) -> None:
    """Bring a file into `folder`, unless it is there; if killed, it leaves the part FOLDER.parts/NAME.part."""
    target, parts = folder / file.file, folder.with_name(f"{folder.name}.parts")
    with written(target, file.size):
        parts.mkdir(parents=True, exist_ok=True)
        name = f"{DATASETS}-{sha256_bytes(f'{folder.name}/{file.file}'.encode())}"
        with locked_file(folder.parent.parent / LOCKS, name):
            if not has_file(target, file.size):
                _fetch(source, f"{address}/{file.file}", file, parts / f"{file.file}.part", target, report)


@contextmanager
def written(target: Path, size: int) -> Iterator[None]:
    """Raise StoreError instead of OSError while a file of the cache is written."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        raise StoreError(
            "there is no space for the file" if full else "the file cannot be written to the cache",
            where=target,
            found=f"{error.strerror}; {size_text(_free(target))} are free",
            allowed=size_text(size),
            fix="free space (dancedata cache prune --max-size SIZE), or set DANCEDATA_CACHE to another disk",
        ) from error


def _free(path: Path) -> int:
    return shutil.disk_usage(next(parent for parent in path.parents if parent.exists())).free


def has_file(path: Path, size: int) -> bool:
    """Return whether a file of this size is there: files of the cache were compared with their hash."""
    return path.is_file() and path.stat().st_size == size


class _Part:
    """The bytes of a file that were fetched: on the disk, and hashed as they arrive."""

    def __init__(self, path: Path, size: int) -> None:
        """Go on from what an earlier process has fetched, at most `size` bytes."""
        self.path, self.have, self._digest = path, 0, sha256()
        if path.exists() and path.stat().st_size <= size:
            with open(path, "rb") as file:
                while chunk := file.read(1 << 20):
                    self._count(chunk)
        else:
            self.clear()

    def _count(self, chunk: bytes) -> None:
        self._digest.update(chunk)
        self.have += len(chunk)

    def clear(self) -> None:
        """Start over with an empty file."""
        self.path.write_bytes(b"")
        self.have, self._digest = 0, sha256()

    def append(self, out: BinaryIO, chunk: bytes) -> None:
        """Write a chunk at the end."""
        out.write(chunk)
        self._count(chunk)

    @property
    def sha256(self) -> str:
        """Hash of all bytes."""
        return self._digest.hexdigest()


def _fetch(source: Client, where: str, file: FileEntry, path: Path, target: Path, report: Report) -> None:
    part = _Part(path, file.size)
    if file.size - part.have > _free(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    report(part.have)
    found = ""
    for _ in range(2):
        _persist(partial(_append, source, where, file, part, report), where, lambda: part.have)
        found = part.sha256
        if found == file.sha256:
            with open(path, "rb") as written:
                os.fsync(written.fileno())
            os.replace(path, target)
            flush_folder(target.parent)
            return
        report(-part.have)
        part.clear()
    path.unlink()
    raise refused("the server sends other bytes than those of the dataset, twice", where,
                  f"sha256 {found[:12]}..., in dataset.json {file.sha256[:12]}...",
                  "it may have been replaced or damaged there; open the address again, or ask who publishes it"
                  )  # fmt: skip


def _append(source: Client, where: str, file: FileEntry, part: _Part, report: Report) -> None:
    """Append to the part what the server sends, up to the size of the file."""
    if part.have == file.size:
        return
    try:
        answer = source.open(file.file, part.have)
    except OutOfRange:
        if part.have == 0:
            raise Interrupted("HTTP 416 for a whole file") from None
        report(-part.have)
        part.clear()
        raise Interrupted("the file on the server is shorter than the part that was fetched before") from None
    if answer.begin != part.have:  # the server ignores ranges
        report(-part.have)
        part.clear()
    with closing(answer.chunks), open(part.path, "ab") as out:
        mark_in_use(out.fileno())  # `cache prune` keeps it
        for chunk in steady(answer.chunks):
            if part.have + len(chunk) > file.size:
                out.close()
                part.path.unlink()
                raise refused("the server sends more bytes than the file has", where,
                              f"more than {file.size:,} bytes",
                              "the dataset may have been replaced there; open the address again")  # fmt: skip
            part.append(out, chunk)
            report(len(chunk))
    if part.have < file.size:
        raise Interrupted(f"the answer ended after {part.have:,} of {file.size:,} bytes")


def _persist(attempt: Callable[[], T], where: str, have: Callable[[], int] = lambda: 0) -> T:
    """Return the result of `attempt`; StoreError after ATTEMPTS failures in a row without new bytes of `have`."""
    failures, reached = 0, have()  # the most bytes: a part may be discarded, and come again
    while True:
        try:
            return attempt()
        except Interrupted as error:
            failures = 1 if have() >= reached + NEW_BYTES else failures + 1
            reached = max(reached, have())
            if failures >= ATTEMPTS:
                fix = "run the same command again later: it goes on from there"
                raise refused(
                    f"the server failed {failures} times", where, f"{error}; {have():,} bytes fetched", fix
                ) from error
            seconds = WAIT_S * 2 ** (failures - 1) if error.wait_s is None else error.wait_s
            if seconds > _SHOWN_S:
                Progress().write(f"{where}: {error}; waiting {seconds:.0f} s")
            time.sleep(seconds)

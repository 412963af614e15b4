"""One file from a server to the disk: in parts that are kept, compared with its hash, and whole or not at all."""

import errno
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dancedata.core.errors import StoreError
from dancedata.core.hashing import json_sha256, sha256_bytes
from dancedata.core.text import size_text
from dancedata.execution.cache_files import DATASETS, LOCKS, locked_file, mark_in_use
from dancedata.files.atomic import sync_folder
from dancedata.files.regular_file import sha256_file
from dancedata.files.strict_json import parse_json
from dancedata.remote.address import Address
from dancedata.remote.bucket import BucketSource
from dancedata.remote.http import HttpSource
from dancedata.remote.hub import HubSource
from dancedata.remote.source import Interrupted, OutOfRange, Source, refused

#: Failures without a new byte after which a file is given up, and seconds to wait after the first; doubled each time.
ATTEMPTS, WAIT_S = 6, 0.5
#: A connection that brings fewer bytes than this in so many seconds is replaced by another.
STALL_BYTES, STALL_S = 1024, 60.0
#: Largest dataset.json, bytes.
MAX_DESCRIPTION = 1 << 26
DATASET_FILE = "dataset.json"
#: What a publication has in addition, and in the place of dataset.json where it has a recipe and no data.
PUBLICATION_FILE = "publication.json"
Report = Callable[[int], None]


@dataclass(frozen=True)
class RemoteFile:
    """Name, bytes and hash of a file that dataset.json lists."""

    name: str
    size: int
    sha256: str


def source_of(address: Address) -> Source:
    """Return the client for an address; made by the process that uses it."""
    if address.scheme == "hf":
        return HubSource(address)
    return HttpSource(address) if address.scheme in ("https", "http") else BucketSource(address)


def fetch_description(source: Source, address: Address, name: str = DATASET_FILE) -> tuple[bytes, Mapping[str, Any]]:
    """Return dataset.json or publication.json as bytes and parsed; StoreError unless its self_sha256 is right."""
    where = f"{address}/{name}"
    problem = ""
    for _ in range(2):
        data = read_small(source, name, where)
        try:
            document = parse_json(data.decode("utf-8"))
            stated = document["self_sha256"]
            content = json_sha256({k: v for k, v in document.items() if k != "self_sha256"})
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            problem = f"{type(error).__name__}, {len(data):,} bytes"
            continue
        if stated == content:
            return data, document
        problem = f"self_sha256 {str(stated)[:12]}..., content {content[:12]}..."
    raise refused(
        f"this is not the {name} of a finished dataset", where, problem, "check the address, or upload it again"
    )


def read_small(source: Source, name: str, where: str) -> bytes:
    """Return the bytes of a file; StoreError if there are more than MAX_DESCRIPTION."""
    data = bytearray()
    _persist(partial(_read_all, source, name, data), lambda: len(data), where)
    return bytes(data)


def _read_all(source: Source, name: str, data: bytearray) -> None:
    del data[:]  # it is small: no ranges
    with closing(source.open(name, 0).chunks) as chunks:
        for chunk in chunks:
            data += chunk
            if len(data) > MAX_DESCRIPTION:
                raise refused(f"the file is larger than any {name}", name, f"more than {MAX_DESCRIPTION:,} bytes")


def fetch_file(source: Source, address: Address, file: RemoteFile, folder: Path, report: Report) -> None:
    """Bring a file into `folder`, unless it is there; processes that ask for the same file wait for the first.

    What arrives goes to ``FOLDER.parts/NAME.part`` and is kept if the process is killed, so that the next one asks
    for the rest. Wrong bytes are deleted and asked for once more.

    Raises
    ------
    StoreError
        If the server fails, has another file, or the disk is full.
    """
    target, parts = folder / file.name, folder.with_name(f"{folder.name}.parts")
    with written(target, file.size):
        parts.mkdir(parents=True, exist_ok=True)
        name = f"{DATASETS}-{sha256_bytes(f'{folder.name}/{file.name}'.encode())}"
        with locked_file(folder.parent.parent / LOCKS, name):
            if not has_file(target, file.size):
                _fetch(source, f"{address}/{file.name}", file, parts / f"{file.name}.part", target, report)


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


def _fetch(source: Source, where: str, file: RemoteFile, part: Path, target: Path, report: Report) -> None:
    have = _size(part)
    if have > file.size:
        part.unlink()
        have = 0
    if file.size - have > _free(part):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    report(have)
    found = ""
    for _ in range(2):
        _persist(partial(_append, source, where, file, part, report), partial(_size, part), where)
        found = sha256_file(part)
        if found == file.sha256:
            with open(part, "rb") as written:
                os.fsync(written.fileno())
            os.replace(part, target)
            sync_folder(target.parent)
            return
        part.unlink()
        report(-file.size)
    raise refused(
        "the server sends other bytes than those of the dataset, twice",
        where,
        f"sha256 {found[:12]}..., in dataset.json {file.sha256[:12]}...",
        "the dataset may have been replaced or damaged there; open the address again, or ask who publishes it",
    )


def _size(part: Path) -> int:
    return part.stat().st_size if part.exists() else 0


def _append(source: Source, where: str, file: RemoteFile, part: Path, report: Report) -> None:
    """Append to the part what the server sends, up to the size of the file."""
    have = _size(part)
    if have >= file.size:
        part.touch()
        return
    try:
        answer = source.open(file.name, have)
    except OutOfRange:
        if have == 0:
            raise Interrupted("HTTP 416 for a whole file") from None
        part.unlink()
        report(-have)
        raise Interrupted("the file on the server is shorter than the part that was fetched before") from None
    if answer.begin != have:  # the server ignores ranges
        report(-have)
        have = 0
    since, arrived = time.monotonic(), 0
    with closing(answer.chunks), open(part, "ab" if have else "wb") as out:
        mark_in_use(out.fileno())  # `cache prune` keeps it
        for chunk in answer.chunks:
            have += len(chunk)
            arrived += len(chunk)
            if have > file.size:
                out.close()
                part.unlink()
                raise refused(
                    "the server sends more bytes than the file has",
                    where,
                    f"more than {file.size:,} bytes",
                    "the dataset may have been replaced there; open the address again",
                )
            out.write(chunk)
            report(len(chunk))
            if time.monotonic() - since > STALL_S:
                if arrived < STALL_BYTES:
                    raise Interrupted(f"the server sent {arrived} bytes in {STALL_S:g} s")
                since, arrived = time.monotonic(), 0
    if have < file.size:
        raise Interrupted(f"the answer ended after {have:,} of {file.size:,} bytes")


def _persist(attempt: Callable[[], None], have: Callable[[], int], where: str) -> None:
    """Call `attempt` until it succeeds; give up after ATTEMPTS failures in a row that brought no byte."""
    failures = 0
    while True:
        before = have()
        try:
            attempt()
        except Interrupted as error:
            failures = 1 if have() > before else failures + 1
            if failures >= ATTEMPTS:
                fix = "run the same command again later: it goes on from there"
                raise refused(
                    f"the server failed {failures} times", where, f"{error}; {have():,} bytes fetched", fix
                ) from error
            time.sleep(WAIT_S * 2 ** (failures - 1) if error.wait_s is None else error.wait_s)
        else:
            return

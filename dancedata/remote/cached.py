"""Datasets of addresses in the cache: the folder of an address, and files that are fetched into it.

Such a folder stays what it is when the address gets another dataset: that one has another self_sha256.
"""

import os
import re
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

from dancedata.core.errors import DanceDataError, StoreError
from dancedata.core.hashing import sha256_bytes
from dancedata.core.system import python_command
from dancedata.files.addresses import Origin, origin_of
from dancedata.files.atomic import write_bytes, write_json
from dancedata.files.cache_files import DATASETS, mark
from dancedata.files.listing import FileEntry
from dancedata.files.strict_json import read_json
from dancedata.kernel import Cache, DatasetFiles, Progress
from dancedata.remote.address import Address, parse_address
from dancedata.remote.client import crossed_a_fork
from dancedata.remote.fetch import fetch_description, fetch_file, has_file, resolved, source_of, written
from dancedata.remote.source import NotThereError, not_cached, refused

#: Folder of what addresses held last.
_ADDRESSES = "addresses"
#: Files above this size are fetched with progress.
_SHOWN_BYTES = 10_000_000
#: Shards that are fetched while one is read.
_AHEAD = 2
_HASH = re.compile(r"[0-9a-f]{64}")
_SHARD = re.compile(r"(?P<split>.+)-(?P<k>\d{5,})-of-(?P<n>\d{5,})\.h5")


def folder_of_address(path: str | Path, cache: Path | None = None) -> Path:
    """Return the folder in the cache of the dataset of an address, with dataset.json; of a branch, its commit."""
    address = parse_address(path)
    root = Cache.at(cache).root
    remembered = root / DATASETS / _ADDRESSES / f"{sha256_bytes(str(address).encode())}.json"
    if is_offline():
        return _last(address, remembered, root)
    if address.is_pinned and remembered.exists():
        with suppress(StoreError):
            return _last(address, remembered, root)
    place = resolved(address)
    name, data, document = _description(place)
    DatasetFiles.of(document, f"{place}/{name}")
    if place != address:
        Progress().write(f"{address} is now commit {place.revision}")
    folder = root / DATASETS / str(document["self_sha256"])
    with written(folder / name, len(data)):
        folder.mkdir(parents=True, exist_ok=True)
        mark(root)
        if not has_file(folder / name, len(data)) or (folder / name).read_bytes() != data:
            write_bytes(folder / name, data)
        write_json(folder.with_name(f"{folder.name}.json"), asdict(Origin(str(place), str(address))))
        for text in {str(address), str(place)}:
            remembered = root / DATASETS / _ADDRESSES / f"{sha256_bytes(text.encode())}.json"
            remembered.parent.mkdir(exist_ok=True)
            write_json(remembered, {"address": text, "self_sha256": folder.name, "resolved": str(place)})
    return folder


def _description(address: Address) -> tuple[str, bytes, Mapping[str, Any]]:
    """Return name and content of dataset.json, or of publication.json where only a recipe is published."""
    source = source_of(address)
    try:
        return DatasetFiles.DATASET, *fetch_description(source, address)
    except NotThereError:
        with suppress(NotThereError):
            data, document = fetch_description(source, address, DatasetFiles.PUBLICATION)
            if "dataset" in document:  # else of an upload that has not come to its end
                return DatasetFiles.PUBLICATION, data, document
        raise


def is_offline() -> bool:
    """Return whether HF_HUB_OFFLINE is set: then no server is asked."""
    return os.environ.get("HF_HUB_OFFLINE", "").upper() in ("1", "ON", "YES", "TRUE")


def _last(address: Address, remembered: Path, root: Path) -> Path:
    """Return the folder that an address had last."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        folder = root / DATASETS / str(read_json(remembered, 1 << 16)["self_sha256"])
        if _HASH.fullmatch(folder.name) and DatasetFiles.path(folder).is_file():
            with suppress(OSError):  # another user's
                os.utime(folder.with_name(f"{folder.name}.json"))  # the time of the last use, for `cache prune`
            return folder
    raise not_cached("the dataset is not in the cache", str(address), address)


@lru_cache(maxsize=4)
def _listed(folder: Path) -> Mapping[str, FileEntry]:
    return {file.file: file for file in DatasetFiles.read(folder).files()}


def fetch(path: Path) -> None:
    """Fetch a file of a dataset of the cache; a shard that is read in order brings the next two along."""
    files = _listed(path.parent)
    if path.name in files:
        fetch_files(path.parent, [files[path.name]])
        _fetch_ahead(path.parent, path.name, files)


def fetch_files(folder: Path, files: list[FileEntry], progress: Progress | None = None, jobs: int = 1) -> int:
    """Fetch files of a dataset of the cache, `jobs` at once; returns how many bytes were missing."""
    from concurrent.futures import ThreadPoolExecutor

    origin = origin_of(folder)
    assert origin is not None  # noqa: S101 (the callers asked)
    if is_offline():
        names = files[0].file if len(files) == 1 else f"{len(files)} files"
        found = f"HF_HUB_OFFLINE is set; {names} missing"
        raise not_cached("a file of the dataset is not in the cache", origin.address, origin.requested, found)
    address = parse_address(origin.address)
    if crossed_a_fork():
        _fetch_in_new_process(folder, files)
        return sum(file.size for file in files)
    source, total = source_of(address), sum(file.size for file in files)
    reporter = progress or Progress(quiet=total < _SHOWN_BYTES)
    with reporter.megabytes("fetching", total) as report:
        pool = ThreadPoolExecutor(jobs, thread_name_prefix="dancedata-fetch")
        try:
            waiting = [pool.submit(fetch_file, source, address, file, folder, report) for file in files]
            for future in waiting:
                future.result()
        finally:
            pool.shutdown(cancel_futures=True)
    return total


def fetch_listed() -> None:
    """Fetch the files whose paths are on stdin; exit with the error."""
    try:
        for path in sys.stdin.read().split("\n"):
            fetch(Path(path))
    except DanceDataError as error:
        sys.exit(str(error))


def _fetch_in_new_process(folder: Path, files: list[FileEntry]) -> None:
    """Fetch files from a forked child, such as a worker of a loader: obstore would hang in it."""
    paths = "\n".join(str(folder / file.file) for file in files)
    command = python_command(f"from {__name__} import fetch_listed; fetch_listed()")
    done = subprocess.run(command, input=paths, capture_output=True, text=True)  # noqa: S603
    if done.returncode:
        raise refused("a file of the dataset cannot be fetched", folder, done.stderr.strip()[-2000:])


def _fetch_ahead(folder: Path, name: str, files: Mapping[str, FileEntry]) -> None:
    match = _SHARD.fullmatch(name)
    if match is None:
        return
    names = [f"{match['split']}-{int(match['k']) + i:05d}-of-{match['n']}.h5" for i in range(-1, _AHEAD + 1)]
    if names[0] in files and not (folder / names[0]).exists():
        return
    if missing := [path for n in names[2:] if not (path := folder / n).exists()]:
        prefetch(missing)


def prefetch(missing: Sequence[Path]) -> None:
    """Fetch files of one dataset of the cache in the background, in this order."""
    files = _listed(missing[0].parent)
    ahead = [files[path.name] for path in missing if path.name in files]
    # The first one alone: it is needed first. A daemon: what it has when the process ends is kept, and the next one
    # goes on from there.
    arguments = missing[0].parent, ahead[:1], ahead[1:]
    threading.Thread(target=_quietly, args=arguments, daemon=True, name="dancedata-ahead").start()


def _quietly(folder: Path, *parts: list[FileEntry]) -> None:
    with suppress(StoreError):  # the reader gets the error when it needs the file
        for files in filter(None, parts):
            fetch_files(folder, files, Progress(quiet=True), jobs=_AHEAD)

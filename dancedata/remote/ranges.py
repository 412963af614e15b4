"""Reading files of an address by ranges: in pieces, each compared with its hash, of which the last used are kept."""

import json
import os
import pickle
import subprocess
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.text import shown
from dancedata.execution.reference_process import python_command
from dancedata.remote.address import BUCKETS, Address, parse_address
from dancedata.remote.bucket import BucketSource, crossed_a_fork
from dancedata.remote.cached import is_offline, origin_of
from dancedata.remote.fetch import persist, source_of
from dancedata.remote.source import Answer, Interrupted, OutOfRange, Source, not_cached, refused, steady, wrong_bytes

#: Bytes that one request asks for, at most: pieces that follow each other come together.
_RUN = 1 << 22
#: Bytes of a digest of SHA-256.
_DIGEST = 32


@dataclass(frozen=True)
class Stream:
    """Settings of reading rows by ranges: ``dancedata.open(ADDRESS, stream=Stream(memory_mb=1000))``.

    Attributes
    ----------
    memory_mb
        MB of pieces that each process keeps. Windows that are read in neighbourhoods need no piece twice if those of
        a neighbourhood fit.
    disk_mb
        MB of pieces of this dataset that are kept in the cache too, for all processes and later runs; 0: none.
    connections
        Requests that a process has under way at once.
    """

    memory_mb: int = 256
    disk_mb: int = 0
    connections: int = 8

    def __post_init__(self) -> None:
        for name, least in (("memory_mb", 8), ("disk_mb", 0), ("connections", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise UsageError(
                    f"invalid value for {name}", found=shown(value), allowed=f"whole numbers from {least}"
                )


class RangeReader:
    """Reads files of one dataset by ranges, from any number of threads. Each process has separate connections.

    Parameters
    ----------
    folder
        Folder of the dataset in the cache, whose address is asked.
    piece
        Bytes of a piece; the last one of a file is short.
    options
        Sizes and numbers.
    """

    def __init__(self, folder: Path, piece: int, options: Stream) -> None:
        self.folder, self.piece, self.options = folder, piece, options
        #: By process. What a forked child inherits stays untouched: its threads do not exist there, its locks may be
        #: held by nobody, and obstore's client may not even be deleted.
        self._of_process: dict[int, _Pieces] = {}

    @property
    def pieces(self) -> "_Pieces":
        """Pieces, threads and connections of this process, made when they are first needed."""
        here = os.getpid()
        if here not in self._of_process:
            self._of_process.setdefault(here, _Pieces(self))
        return self._of_process[here]


class RangedFile:
    """A file of an address whose bytes are read by ranges.

    `digests` returns the SHA-256 of its pieces, 32 bytes each; it is called once.
    """

    def __init__(self, reader: RangeReader, name: str, size: int, digests: Callable[[], bytes]) -> None:
        self._reader, self.name, self.size, self._load_digests = reader, name, size, digests

    @cached_property
    def _digests(self) -> bytes:
        return self._load_digests()

    def numbers(self, position: int, n_bytes: int) -> range:
        """Return the numbers of the pieces that hold some bytes."""
        if position < 0 or position + n_bytes > self.size:
            raise ValueError(f"bytes {position} to {position + n_bytes} of {self.size}")
        return range(position // self._reader.piece, -(-(position + n_bytes) // self._reader.piece))

    def is_piece(self, number: int, data: bytes | memoryview) -> bool:
        """Return whether bytes are those of a piece."""
        return sha256(data).digest() == self._digests[number * _DIGEST : (number + 1) * _DIGEST]

    def want(self, position: int, n_bytes: int) -> None:
        """Note bytes that are read soon; the next reading asks for all of them at once."""
        self._reader.pieces.want(self, self.numbers(position, n_bytes))

    def read_into(self, view: memoryview, position: int) -> None:
        """Fill `view` with the bytes from `position` on.

        Raises
        ------
        StoreError
            If the server fails, or has other bytes.
        """
        piece, numbers = self._reader.piece, self.numbers(position, view.nbytes)
        for number, future in zip(numbers, self._reader.pieces.ask(self, numbers), strict=True):
            begin = max(position, number * piece)
            data = memoryview(future.result())[begin - number * piece :]
            n = min(len(data), position + view.nbytes - begin)
            view[begin - position : begin - position + n] = data[:n]


class _Pieces:
    """The pieces that one process has, the last used ones up to a limit, and the threads that fetch others."""

    def __init__(self, reader: RangeReader) -> None:
        origin = origin_of(reader.folder)
        assert origin is not None  # noqa: S101 (only datasets of the cache are read by ranges)
        self._address, self._requested, self._piece = parse_address(origin.address), origin.requested, reader.piece
        self._limit = reader.options.memory_mb * 1_000_000
        self._disk = _Disk(reader.folder, reader.options.disk_mb * 1_000_000) if reader.options.disk_mb else None
        self._threads = ThreadPoolExecutor(reader.options.connections, "dancedata-range")
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[str, int], Future[bytes]] = OrderedDict()
        self._wanted: dict[tuple[str, int], RangedFile] = {}

    @cached_property
    def _source(self) -> Source:
        forked = self._address.scheme in BUCKETS and crossed_a_fork()
        return _OtherProcess(self._address) if forked else source_of(self._address)

    def want(self, file: RangedFile, numbers: range) -> None:
        """Note pieces, at most half of what is kept: others would push them out before they are read."""
        with self._lock:
            for number in numbers:
                key = file.name, number
                if key not in self._kept and len(self._wanted) * self._piece < self._limit // 2:
                    self._wanted[key] = file

    def ask(self, file: RangedFile, numbers: range) -> list[Future[bytes]]:
        """Return pieces that are there, or on their way together with the wanted ones."""
        with self._lock:
            wanted = {key: f for key, f in self._wanted.items() if key not in self._kept}
            self._wanted = {}
            keys = [(file.name, number) for number in numbers]
            # In this order, so that those that are waited for come first, and later blocks last.
            missing = {key: file for key in keys if key not in self._kept} | wanted
            for key in missing:
                self._kept[key] = Future()
            asked = [self._kept[key] for key in keys]
            for key in keys:
                self._kept.move_to_end(key)
            self._drop_oldest()
            for names in _runs(list(missing), _RUN // self._piece):
                of_file = missing[names[0]]
                self._threads.submit(self._fetch_run, of_file, {n: self._kept[of_file.name, n] for _, n in names})
        return asked

    def _drop_oldest(self) -> None:
        excess = len(self._kept) - max(1, self._limit // self._piece)
        if excess > 0:
            there = (key for key, future in self._kept.items() if future.done())
            for key in [key for key, _ in zip(there, range(excess), strict=False)]:
                del self._kept[key]

    def _fetch_run(self, file: RangedFile, futures: dict[int, "Future[bytes]"]) -> None:
        """Fetch pieces that follow each other; in a thread."""
        try:
            # Does nothing, and raises RuntimeError while the process ends: it waits for all that is submitted.
            self._threads.submit(int)
            missing = dict.fromkeys(futures)
            for number in list(missing) if self._disk is not None else ():
                data = self._disk.get(file, number) if self._disk is not None else None
                if data is not None:
                    futures[number].set_result(data)
                    del missing[number]
            for run in _runs([(file.name, number) for number in missing], len(futures)):
                for number, data in self._fetched(file, run[0][1], run[-1][1] + 1):
                    if self._disk is not None:
                        self._disk.put(file, number, data)
                    futures[number].set_result(data)
        except BaseException as error:  # noqa: BLE001 (it is raised where the pieces are read)
            self._fail(file, futures, error)

    def _fail(self, file: RangedFile, futures: dict[int, "Future[bytes]"], error: BaseException) -> None:
        with self._lock:  # the next reading asks again
            for number, future in futures.items():
                if not future.done() and self._kept.get((file.name, number)) is future:
                    del self._kept[file.name, number]
        for future in futures.values():
            if not future.done():
                future.set_exception(error)

    def _fetched(self, file: RangedFile, first: int, stop: int) -> Iterator[tuple[int, bytes]]:
        """Fetch pieces first to stop - 1, and compare them; wrong bytes are asked for once more."""
        begin, end, where = first * self._piece, min(stop * self._piece, file.size), f"{self._address}/{file.name}"
        if is_offline():
            raise not_cached("a part of the dataset is not in the cache", where, self._requested)
        wrong = first
        for _ in range(2):
            data = bytearray()
            persist(partial(self._append, file.name, data, begin, end), where, partial(len, data))
            view = memoryview(data)
            pieces = {n: view[(n - first) * self._piece :][: self._piece] for n in range(first, stop)}
            bad = [n for n, piece in pieces.items() if not file.is_piece(n, piece)]
            if not bad:
                yield from ((n, bytes(piece)) for n, piece in pieces.items())
                return
            wrong = bad[0]
        raise wrong_bytes(where, f"bytes {wrong * self._piece} to {min((wrong + 1) * self._piece, file.size)}")

    def _append(self, name: str, data: bytearray, begin: int, end: int) -> None:
        """Append to `data` what the server sends of bytes begin to end, from where it ended before."""
        where, have = f"{self._address}/{name}", begin + len(data)
        try:
            answer = self._source.open(name, have, end)
        except OutOfRange:
            fix = "the dataset may have been replaced there; open the address again"
            raise refused("the file on the server is too short", where, f"no byte {have}", fix) from None
        with closing(answer.chunks):
            for chunk in steady(answer.chunks):
                data += chunk
                if begin + len(data) > end:
                    raise refused("the server sends more bytes than were asked for", where, f"bytes {have} to {end}")
        if begin + len(data) < end:
            raise Interrupted(f"the answer ended at byte {begin + len(data):,} of {have:,} to {end:,}")


def _runs(keys: Sequence[tuple[str, int]], longest: int) -> Iterator[list[tuple[str, int]]]:
    """Cut names and numbers of pieces into runs of pieces that follow each other in a file."""
    cuts = [0]
    for k, ((name, number), (next_name, next_number)) in enumerate(pairwise(keys), start=1):
        if name != next_name or next_number != number + 1 or k - cuts[-1] >= longest:
            cuts.append(k)
    yield from (list(keys[a:b]) for a, b in pairwise([*cuts, len(keys)]) if b > a)


class _Disk:
    """Pieces in the cache, SELF_SHA256.pieces/FILE.NUMBER, the last used ones up to a limit; compared when read."""

    def __init__(self, folder: Path, limit: int) -> None:
        self._folder, self._limit = folder.with_name(f"{folder.name}.pieces"), limit
        self._lock, self._since = threading.Lock(), limit

    def get(self, file: RangedFile, number: int) -> bytes | None:
        """Return a piece if it is there, whole."""
        path = self._folder / f"{file.name}.{number}"
        with suppress(OSError):
            data = path.read_bytes()
            if file.is_piece(number, data):
                os.utime(path)
                return data
        return None

    def put(self, file: RangedFile, number: int, data: bytes) -> None:
        """Keep a piece; a disk that is full keeps none."""
        path = self._folder / f"{file.name}.{number}"
        temporary = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}")
        with suppress(OSError):
            self._folder.mkdir(exist_ok=True)
            temporary.write_bytes(data)  # not flushed: pieces are compared when they are read
            os.replace(temporary, path)
        with self._lock:
            self._since += len(data)
            if self._since > self._limit // 16:
                self._since = 0
                self._drop_oldest()

    def _drop_oldest(self) -> None:
        """Remove the pieces that were not used for the longest time, down to 15/16 of the limit."""
        files = []
        for entry in os.scandir(self._folder) if self._folder.exists() else ():
            with suppress(OSError):  # another process removes, too
                status = entry.stat(follow_symlinks=False)
                files.append((status.st_mtime_ns, entry.path, status.st_size))
        excess = sum(size for *_, size in files) - self._limit // 16 * 15
        for _, path, size in sorted(files):
            if excess <= 0:
                break
            excess -= size
            with suppress(OSError):
                os.unlink(path)


class _OtherProcess:
    """A bucket for a process that was forked after obstore was used: a separate process requests the ranges."""

    def __init__(self, address: Address) -> None:
        self.address, self._lock = address, threading.Lock()
        command = python_command(f"from {__name__} import serve; serve()", str(address))
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603

    def resolve(self) -> Address:
        """Return the address: a bucket has no commits."""
        return self.address

    def open(self, name: str, begin: int, end: int | None = None) -> Answer:
        """Ask for bytes of an object."""
        assert self._process.stdin is not None  # noqa: S101 (pipes)
        assert self._process.stdout is not None  # noqa: S101
        with self._lock:
            try:
                self._process.stdin.write(json.dumps([name, begin, end]).encode() + b"\n")
                self._process.stdin.flush()
                result = pickle.load(self._process.stdout)  # noqa: S301 (our own process)
            except (OSError, EOFError, pickle.UnpicklingError) as error:
                raise refused("the process that reads ranges has ended", self.address, shown(error)) from error
        if isinstance(result, BaseException):
            raise result
        return Answer(begin, _once(result))


def _once(data: bytes) -> Generator[bytes, None, None]:
    yield data


def serve() -> None:
    """Answer the requests of `_OtherProcess` on stdin until it is closed."""
    source = BucketSource(parse_address(sys.argv[1]))
    for line in sys.stdin.buffer:
        name, begin, end = json.loads(line)
        result: Any
        try:
            with closing(source.open(name, begin, end).chunks) as chunks:
                result = b"".join(chunks)
        except (Interrupted, OutOfRange, StoreError) as error:
            result = error
        pickle.dump(result, sys.stdout.buffer)
        sys.stdout.buffer.flush()

"""The interface of all servers: files by name, from any byte; temporary and permanent failures."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass

from dancedata.core.errors import StoreError

#: A connection that brings fewer bytes than this within these seconds is replaced by another.
STALL_BYTES, STALL_S = 1024, 60.0


class Interrupted(Exception):  # noqa: N818 (a state of a download, not an error of the caller)
    """The server failed in a way that may pass; `wait_s`: seconds that it asks to wait, None if it does not say."""

    def __init__(self, problem: str, wait_s: float | None = None) -> None:
        super().__init__(problem)
        self.wait_s = wait_s


class OutOfRange(Interrupted):
    """The file is shorter than the part that was fetched before."""

    def __init__(self, problem: str = "HTTP 416") -> None:
        super().__init__(problem)


@dataclass
class Answer:
    """Bytes of a file: `chunks` begin at byte `begin`, which is 0 where the server ignores ranges."""

    begin: int
    chunks: Generator[bytes, None, None]


def steady(chunks: Iterator[bytes]) -> Iterator[bytes]:
    """Yield chunks of a server; Interrupted if it sends too little for too long."""
    since, arrived = time.monotonic(), 0
    for chunk in chunks:
        yield chunk
        arrived += len(chunk)
        if time.monotonic() - since > STALL_S:
            if arrived < STALL_BYTES:
                raise Interrupted(f"the server sent {arrived} bytes in {STALL_S:g} s")
            since, arrived = time.monotonic(), 0


_SECRETS = re.compile(r"(?<=://)[^/@\s]*@|\?\S+")


def public_line(text: str) -> str:
    """Return the first line of a client's or server's text, its addresses without passwords and signatures."""
    return _SECRETS.sub("", text.split("\n")[0])


def read_within(chunks: Iterator[bytes], limit: int, too_large: Callable[[int], StoreError]) -> bytes:
    """Return all bytes of a server; raise the error that `too_large` gives for more than `limit`."""
    data = bytearray()
    for chunk in steady(chunks):
        data += chunk
        if len(data) > limit:
            raise too_large(len(data))
    return bytes(data)


def not_cached(problem: str, where: object, requested: object, found: str = "HF_HUB_OFFLINE is set") -> StoreError:
    """Return the error for what no server may be asked for."""
    return refused(problem, where, found, f"fetch it where there is a network: dancedata pull {requested}")


class NotThereError(StoreError):
    """The folder on the server does not have this file."""


def refused(
    problem: str, where: object, found: object = None, fix: str | None = None, kind: type[StoreError] = StoreError
) -> StoreError:
    """Return the error for a file that a server does not give."""
    return kind(problem, where=where, found=found, fix=fix)

"""What all servers have in common: files by name, from any byte; failures that pass, and failures that stay."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Protocol

from dancedata.core.errors import StoreError
from dancedata.remote.address import Address


class Interrupted(Exception):  # noqa: N818 (a state of a download, not an error of the caller)
    """The server failed in a way that may pass.

    Parameters
    ----------
    problem
        Text for the error, if it does not pass.
    wait_s
        Seconds that the server asks to wait; None: it does not say.
    """

    def __init__(self, problem: str, wait_s: float | None = None) -> None:
        super().__init__(problem)
        self.wait_s = wait_s


class OutOfRange(Exception):  # noqa: N818
    """The file is shorter than the part that was fetched before (HTTP 416)."""


@dataclass
class Answer:
    """Bytes of a file: `chunks` begin at byte `begin`, which is 0 where the server ignores ranges."""

    begin: int
    chunks: Generator[bytes, None, None]


class Source(Protocol):
    """A folder on a server."""

    def open(self, name: str, begin: int) -> Answer:
        """Ask for a file from a byte on.

        Raises
        ------
        Interrupted, OutOfRange
            See there.
        StoreError
            For failures that stay: no such file, no permission.
        """

    def resolve(self) -> Address:
        """Return the address whose content does not change: that of the commit, where there are commits."""


class NotThereError(StoreError):
    """The folder on the server does not have this file."""


def refused(
    problem: str,
    where: object,
    found: object = None,
    fix: str | None = None,
    kind: type[StoreError] = StoreError,
) -> StoreError:
    """Return the error for a file that a server does not give."""
    return kind(problem, where=where, found=found, fix=fix)

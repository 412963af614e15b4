"""Files of servers and object stores by obstore: https, s3, gs and az; credentials are those of its environment."""

import os
import re
import urllib.request
from collections.abc import Generator, Mapping
from datetime import timedelta
from email.utils import parsedate_to_datetime
from http.client import HTTPException
from time import time
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote

from dancedata.core.packages import require
from dancedata.core.text import shown
from dancedata.remote.address import BUCKETS, Address
from dancedata.remote.source import Answer, Interrupted, NotThereError, OutOfRange, public_line, refused

#: Seconds for the head of an answer, and without a byte of its body, after which a connection is given up.
TIMEOUT_S = 30.0
#: A failed request is repeated by the caller, from the last byte on.
_RETRY = {"max_retries": 0}
#: Longest wait that a server may ask for.
_MAX_WAIT_S = 300.0
_PASSING = {408, 425, 429, 500, 502, 503, 504}
_STATUS = re.compile(r"status code: (\d{3})")
#: The innermost causes that obstore reports of its HTTP client: a text, or a name as TimedOut.
_CAUSES = re.compile(r'(?:"([^"\n]+)"|\b([A-Z]\w+)),\n')
#: Causes that stay, by a word of obstore's report.
_STAYING = {
    "BadScheme": "the server redirects to an address that is not https",
    "TooManyRedirects": "the server redirects in a circle",
    "InvalidCertificate": "the server's certificate is not valid",
    "MissingContentLength": "the server does not state the length of the file",
}
_KEPT = "what was fetched before is kept: the same command goes on from there"
_VARIABLES = "set the client's own variables (AWS_ACCESS_KEY_ID, ...); public: AWS_SKIP_SIGNATURE=true"

#: The process that has used obstore first: its threads do not exist in forked children, where obstore would hang.
_first_used_in: int | None = None


def crossed_a_fork() -> bool:
    """Return whether obstore was used before this process was forked, so that it cannot be used here."""
    return _first_used_in not in (None, os.getpid())


class Client:
    """A folder of a server, or a prefix of a bucket."""

    def __init__(self, address: Address) -> None:
        require("remote", ("obstore",), what=f"an address of {address.scheme}://")
        from obstore.store import HTTPStore, from_url

        global _first_used_in
        _require_no_fork(address)
        _first_used_in = os.getpid()
        self.address = address
        retry: Any = _RETRY
        if address.scheme in BUCKETS:
            self.store: Any = from_url(str(address), retry_config=retry)
            return
        self.url, self.headers = self.place()
        options: Any = {
            "allow_http": self.url.startswith("http:"),  # else redirections to http are refused, too
            "default_headers": {"Accept-Encoding": "identity", **self.headers},
            "read_timeout": timedelta(seconds=TIMEOUT_S),
            "timeout": timedelta(days=1),
            "user_agent": "dancedata",
        }
        self.store = HTTPStore.from_url(self.url, client_options=options, retry_config=retry)

    def place(self) -> tuple[str, Mapping[str, str]]:
        """Return the URL of the folder, and headers for its host, which are not sent to others."""
        return str(self.address), {}

    def resolve(self) -> Address:
        """Return the address: buckets and servers have no commits."""
        return self.address

    def open(self, name: str, begin: int) -> Answer:
        """Ask for a file from a byte on."""
        import obstore
        from obstore import exceptions

        _require_no_fork(self.address)
        options: Any = {"range": {"offset": begin}} if begin else None
        try:
            result = obstore.get(self.store, name, options=options)
        except exceptions.NotSupportedError:  # the server ignores ranges
            return self.open(name, 0)
        except (exceptions.BaseError, OSError) as error:
            raise self._failed(error, name) from None
        return Answer(begin, self._chunks(result, name))

    def _chunks(self, result: Any, name: str) -> Generator[bytes, None, None]:
        from obstore import exceptions

        try:
            for chunk in result.stream(min_chunk_size=1):  # as they arrive: those of a connection that breaks count
                yield bytes(chunk)
        except (exceptions.BaseError, OSError) as error:
            raise self._failed(error, name) from None

    def _failed(self, error: Exception, name: str) -> Exception:
        text, stated = str(error), _STATUS.search(str(error))
        status = int(stated[1]) if stated else None
        if status == 416:
            return OutOfRange()
        if status in _PASSING:
            return Interrupted(f"HTTP {status}", self._retry_after(name))
        if status is not None:
            return self.failure(status, name)
        where = f"{self.address}/{name}"
        causes = _CAUSES.findall(text.partition("HttpError {")[2])
        found = shown(public_line("".join(causes[-1]) if causes else text), 200)
        problem = next((problem for word, problem in _STAYING.items() if word in text), None)
        return refused(problem, where, found) if problem else Interrupted(found)

    def failure(self, status: int, name: str) -> Exception:
        """Return the error for a status that does not pass."""
        where, found = f"{self.address}/{name}", f"HTTP {status}"
        if status == 404:
            fix = "check the address: it is that of the folder with dataset.json" if name == "dataset.json" else None
            return refused("there is no such file", where, found, fix, NotThereError)
        if status in (401, 403):
            fix = _VARIABLES if self.address.scheme in BUCKETS else f"dancedata reads public https folders; {_KEPT}"
            return refused("the server does not give this file to you", where, found, fix)
        return refused("the server does not give the file", where, found)

    def _retry_after(self, name: str) -> float | None:
        """Return how long a server asks to wait, of which obstore does not tell; None if it does not say."""
        if self.address.scheme in BUCKETS:
            return None
        request = urllib.request.Request(f"{self.url}/{quote(name)}", method="HEAD")  # noqa: S310 (https, or this machine)
        for header, value in self.headers.items():
            request.add_unredirected_header(header, value)
        try:
            urllib.request.urlopen(request, timeout=TIMEOUT_S).close()  # noqa: S310
        except HTTPError as error:
            error.close()
            return _seconds(error.headers.get("Retry-After", ""))
        except (OSError, HTTPException, ValueError):
            pass
        return None


def _seconds(text: str) -> float | None:
    """Return the value of Retry-After, a number of seconds or a date, from now on; None for anything else."""
    try:
        seconds = float(text) if text.isdecimal() else parsedate_to_datetime(text).timestamp() - time()
    except ValueError:
        return None
    return min(max(seconds, 0.0), _MAX_WAIT_S)


def _require_no_fork(address: Address) -> None:
    """Raise StoreError in a process that was forked after obstore was used: a call would never return."""
    if crossed_a_fork():
        raise refused("obstore was used before this process was forked, and would hang here", str(address),
                      fix="open the address before the fork, or start workers with spawn")  # fmt: skip

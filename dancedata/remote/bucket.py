"""Files of object stores: s3, gs and az, with obstore; credentials are those of its environment."""

import os
from collections.abc import Generator
from datetime import timedelta
from typing import Any

from dancedata.core.packages import require
from dancedata.core.text import shown
from dancedata.remote.address import Address
from dancedata.remote.source import Answer, Interrupted, NotThereError, OutOfRange, public_line, refused

_CHUNK = 1 << 20
#: Seconds of obstore's own attempts; longer failures are the caller's.
_RETRY = {"max_retries": 2, "retry_timeout": timedelta(seconds=20)}


#: The process that has used obstore first: its threads do not exist in forked children, where obstore would hang.
_first_used_in: int | None = None


def crossed_a_fork() -> bool:
    """Return whether obstore was used before this process was forked, so that it cannot be used here."""
    return _first_used_in not in (None, os.getpid())


class BucketSource:
    """A prefix of a bucket."""

    def __init__(self, address: Address) -> None:
        require("remote", ("obstore",), what=f"an address of {address.scheme}://")
        from obstore.store import from_url

        global _first_used_in
        _require_no_fork(address)
        _first_used_in = os.getpid()
        self.address = address
        retry: Any = _RETRY
        self.store = from_url(str(address), retry_config=retry)

    def resolve(self) -> Address:
        """Return the address: a bucket has no commits."""
        return self.address

    def open(self, name: str, begin: int) -> Answer:
        """Ask for an object from a byte on."""
        import obstore
        from obstore import exceptions

        _require_no_fork(self.address)
        options: Any = {"range": {"offset": begin}} if begin else None
        where = f"{self.address}/{name}"
        try:
            result = obstore.get(self.store, name, options=options)
        except (FileNotFoundError, exceptions.NotFoundError):
            fix = "check bucket and prefix: the address is that of the folder with dataset.json"
            raise refused("there is no such object", where, fix=fix, kind=NotThereError) from None
        except (PermissionError, exceptions.PermissionDeniedError, exceptions.UnauthenticatedError):
            fix = "set the client's own variables (AWS_ACCESS_KEY_ID, ...); public: AWS_SKIP_SIGNATURE=true"
            raise refused("the object store does not give this object to you", where, fix=fix) from None
        except (exceptions.BaseError, OSError) as error:
            raise _failed(error, is_range=bool(begin)) from None
        return Answer(begin, _chunks(result))


def _require_no_fork(address: Address) -> None:
    """Raise StoreError in a process that was forked after obstore was used: a call would never return."""
    if crossed_a_fork():
        raise refused(
            "obstore was used before this process was forked, and would hang here",
            str(address),
            fix="open the address before the fork, or start workers with spawn",
        )


def _chunks(result: Any) -> Generator[bytes, None, None]:
    from obstore import exceptions

    try:
        for chunk in result.stream(min_chunk_size=_CHUNK):
            yield bytes(chunk)
    except (exceptions.BaseError, OSError) as error:
        raise _failed(error) from None


def _failed(error: Exception, *, is_range: bool = False) -> Exception:
    """Return the failure; of obstore's long text the first line, which holds no keys."""
    text = str(error)
    if is_range and "416" in text:
        return OutOfRange()
    return Interrupted(shown(f"{type(error).__name__}: " + public_line(text), 200))

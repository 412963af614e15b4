"""Files from https servers: ranges, redirections and their limits, and what each status means."""

import ssl
import urllib.error
import urllib.request
from collections.abc import Generator, Mapping
from email.utils import parsedate_to_datetime
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from time import monotonic, time
from typing import Any
from urllib.parse import quote, urlsplit

from dancedata.core.errors import StoreError
from dancedata.core.text import quoted, shown
from dancedata.core.typing import override
from dancedata.remote.address import LOOPBACK, Address
from dancedata.remote.source import Answer, Interrupted, NotThereError, OutOfRange, refused

#: Seconds without a byte after which a connection is given up.
TIMEOUT_S = 30.0
#: Seconds for the lines of an answer's head, and for those between parts of its body and after it.
HEAD_S = 60.0
_CHUNK = 1 << 20
#: Longest wait that a server may ask for.
_MAX_WAIT_S = 300.0
_PASSING = {408, 425, 429, 500, 502, 503, 504}
_KEPT = "what was fetched before is kept: the same command goes on from there"


class HttpSource:
    """A folder of a server."""

    def __init__(self, address: Address) -> None:
        self.address = address
        self.base = f"{address}/"

    def resolve(self) -> Address:
        """Return the address: a server has no commits."""
        return self.address

    def headers(self) -> Mapping[str, str]:
        """Return headers for the first host; they are not sent to others."""
        return {}

    def open(self, name: str, begin: int) -> Answer:
        """Ask for a file from a byte on."""
        response = self.request(self.base + quote(name), name, begin)
        if response.status == 206:
            stated = str(response.headers.get("Content-Range", ""))
            if not stated.startswith(f"bytes {begin}-"):
                response.close()
                raise Interrupted(f"asked for bytes from {begin}, got {quoted(stated, 80)}")
        return Answer(begin if response.status == 206 else 0, body(response))

    def request(self, url: str, name: str, begin: int = 0) -> HTTPResponse:
        """Return the server's answer to GET."""
        request = urllib.request.Request(url, headers={"Accept-Encoding": "identity", "User-Agent": "dancedata"})  # noqa: S310
        if _host(url) == _host(self.base):
            for header, value in self.headers().items():
                request.add_unredirected_header(header, value)
        if begin:
            request.add_header("Range", f"bytes={begin}-")
        try:
            response: HTTPResponse = opener(_Http, _Https, _SafeRedirection).open(request, timeout=TIMEOUT_S)
        except urllib.error.HTTPError as error:
            error.close()
            raise self._failed(error, name, url) from None
        except urllib.error.URLError as error:
            if isinstance(error.reason, ssl.SSLCertVerificationError):
                raise refused(
                    "the server's certificate is not valid", self._where(name), str(error.reason.verify_message)
                ) from None
            raise Interrupted(f"no connection: {shown(error.reason)}") from error
        except (HTTPException, OSError) as error:
            raise Interrupted(f"no valid answer: {shown(error)}") from error
        except ValueError as error:  # an invalid address of a redirection
            raise refused("the server's answer is not valid HTTP", self._where(name), shown(error)) from error
        return response

    def _where(self, name: str) -> str:
        return f"{self.address}/{name}"

    def _failed(self, error: urllib.error.HTTPError, name: str, url: str) -> Exception:
        status = error.code
        if status == 416:
            return OutOfRange()
        if status in _PASSING:
            return Interrupted(f"HTTP {status}", _wait(error.headers.get("Retry-After")))
        moved = urlsplit(error.url or url).netloc != urlsplit(url).netloc
        if status in (401, 403) and moved:
            # The signed address that a hub redirects to has expired; a new one is asked for.
            return Interrupted(f"HTTP {status} of the server that {urlsplit(url).hostname} redirects to")
        return self.failure(status, error.headers, name)

    def failure(self, status: int, headers: Any, name: str) -> StoreError:
        """Return the error for a status that does not pass."""
        where = self._where(name)
        if status == 404:
            fix = "check the address: it is that of the folder with dataset.json" if name == "dataset.json" else None
            return refused("there is no such file on the server", where, "HTTP 404", fix, NotThereError)
        if status in (401, 403):
            problem = "the server asks for a login" if status == 401 else "the server does not give this file to you"
            return refused(problem, where, f"HTTP {status}", f"dancedata reads public https folders; {_KEPT}")
        return refused("the server does not give the file", where, f"HTTP {status}")


def _host(url: str) -> tuple[str, str]:
    parts = urlsplit(url)
    return parts.scheme, parts.netloc


def body(response: HTTPResponse) -> Generator[bytes, None, None]:
    """Yield the bytes of an answer as they arrive."""
    with response:
        while True:
            try:
                chunk = response.read1(_CHUNK)
            except TimeoutError as error:
                raise Interrupted(f"the server sent nothing for {TIMEOUT_S:g} s") from error
            except (HTTPException, OSError) as error:
                raise Interrupted(f"the connection broke: {shown(error)}") from error
            if not chunk:
                return
            yield chunk


def _wait(text: str | None) -> float | None:
    """Return the seconds of Retry-After: a number, or a date."""
    if text is None:
        return None
    try:
        seconds = float(text) if text.strip().isdecimal() else parsedate_to_datetime(text).timestamp() - time()
    except ValueError:
        return None
    return min(max(seconds, 0.0), _MAX_WAIT_S)


class _Lines:
    """Bytes of an answer whose lines end: http.client reads as many heads, chunk sizes and trailers as are sent."""

    def __init__(self, raw: Any) -> None:
        self._raw, self._until = raw, monotonic() + HEAD_S

    def __getattr__(self, name: str) -> Any:
        return getattr(self._raw, name)

    def readline(self, limit: int = -1) -> bytes:
        """Read a line as it arrives; TimeoutError if lines take too long, each or together."""
        line = bytearray()
        while not line.endswith(b"\n") and not 0 <= limit <= len(line):
            if monotonic() > self._until:
                raise TimeoutError(f"its head, or a line of its body, was not complete in {HEAD_S:g} s")
            seen = self._raw.peek(1)
            n = seen.find(b"\n") + 1 or len(seen)
            n = n if limit < 0 else min(n, limit - len(line))
            if not n:
                break
            line += self._raw.read(n)
        return bytes(line)

    def read1(self, n: int = -1) -> bytes:
        """Read the bytes that have arrived."""
        data: bytes = self._raw.read1(n)
        self._until = monotonic() + HEAD_S
        return data


class _Answer(HTTPResponse):
    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.fp: Any = _Lines(self.fp)


class _Connection(HTTPConnection):
    response_class = _Answer


class _SafeConnection(HTTPSConnection):
    response_class = _Answer


class _Http(urllib.request.HTTPHandler):
    def http_open(self, req: Any) -> Any:
        return self.do_open(_Connection, req)


class _Https(urllib.request.HTTPSHandler):
    def https_open(self, req: Any) -> Any:
        return self.do_open(_SafeConnection, req)


class Redirection(urllib.request.HTTPRedirectHandler):
    """Follows redirections, and closes the connection if that fails."""

    @override
    def http_error_302(self, req: Any, fp: Any, code: int, msg: str, headers: Any) -> Any:
        try:
            return super().http_error_302(req, fp, code, msg, headers)
        except BaseException:
            fp.close()
            raise

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302


class _SafeRedirection(Redirection):
    """Follows redirections to https; a token goes to the host that it is for, and to no other."""

    def redirect_request(self, req: Any, fp: Any, code: int, msg: str, headers: Any, newurl: str) -> Any:
        old, new = urlsplit(req.full_url), urlsplit(newurl)
        local = old.scheme == "http" and new.scheme == "http" and new.hostname in (*LOOPBACK, old.hostname)
        if new.scheme != "https" and not local:
            fp.close()
            raise refused(
                "the server redirects to an address that is not https",
                f"{old.scheme}://{old.netloc}{old.path}",
                f"{shown(new.scheme, 20)}://{shown(new.netloc.rpartition('@')[2], 80)}",
                "nothing was fetched from there",
            )
        request = super().redirect_request(req, fp, code, msg, headers, newurl)
        if request is not None and (old.scheme, old.netloc) == (new.scheme, new.netloc):
            for header, value in req.unredirected_hdrs.items():
                if header != "Host":
                    request.add_unredirected_header(header, value)
        return request

    def http_error_302(self, req: Any, fp: Any, code: int, msg: str, headers: Any) -> Any:
        # urllib's own check of schemes comes before redirect_request, and lets ftp pass.
        scheme = urlsplit(headers.get("location", headers.get("uri", ""))).scheme
        if scheme and scheme not in ("http", "https"):
            self.redirect_request(req, fp, code, msg, headers, f"{scheme}://")
        return super().http_error_302(req, fp, code, msg, headers)

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302


def opener(*handlers: type[urllib.request.BaseHandler]) -> urllib.request.OpenerDirector:
    """Return an opener for http and https alone, with these handlers: a server must not redirect to files or FTP."""
    result = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler,
        urllib.request.UnknownHandler,
        urllib.request.HTTPDefaultErrorHandler,
        urllib.request.HTTPErrorProcessor,
        *handlers,
    ):
        result.add_handler(handler())
    return result

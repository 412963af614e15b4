"""The server of `dancedata view`: 127.0.0.1 only, one secret, and no file names from requests."""

import hmac
import secrets
import sys
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

from dancedata.core.errors import UsageError
from dancedata.viewer.site import HTML, Answer, Site

#: Names of this machine; a page elsewhere whose name was made to point here has another one (DNS rebinding).
_HOSTS = ("127.0.0.1", "localhost", "[::1]")
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
}
#: Seconds after which a connection without a request is closed.
_IDLE_S = 60


class ViewServer(ThreadingHTTPServer):
    """Serves a site on 127.0.0.1.

    Parameters
    ----------
    port
        0 for a free one.

    Raises
    ------
    UsageError
        If the port is taken.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, site: Site, port: int = 0) -> None:
        self.site = site
        self.token = secrets.token_urlsafe(24)
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except (OSError, OverflowError) as error:
            fix = "choose another --port, or leave it out for a free one"
            raise UsageError(
                "the port cannot be used", where=f"127.0.0.1:{port}", found=str(error), fix=fix
            ) from error

    @property
    def address(self) -> str:
        """The address to open, with the secret."""
        return f"http://127.0.0.1:{self.server_port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """Name of the cookie: cookies of one host are shared by all of its ports."""
        return f"dancedata{self.server_port}"

    def handle_error(self, request: object, client_address: object) -> None:
        """Print nothing where a browser has closed its connection."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]  # as the server itself calls it


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "dancedata", ""
    timeout = _IDLE_S
    server: ViewServer
    error_content_type = "text/plain; charset=utf-8"
    error_message_format = "%(code)d %(message)s\n"

    def do_GET(self) -> None:
        """Answer a request."""
        if (self.headers.get("Host") or "").rpartition(":")[0] not in _HOSTS:
            self._send(Answer.of(403, "unknown host"))
            return
        try:
            url = urlsplit(self.path)
            query = parse_qs(url.query, keep_blank_values=True)
        except ValueError:
            self._send(Answer.of(400, "not an address"))
            return
        if url.path == "/" and self._is_secret(query.get("token", [""])[0]):
            cookie = f"{self.server.cookie}={self.server.token}; HttpOnly; SameSite=Strict; Path=/"
            self._send(Answer.of(303, ""), {"Location": "/", "Set-Cookie": cookie})
        elif not self._is_secret(self._cookie()):
            self._send(Answer.of(403, "open the address that dancedata view printed"))
        else:
            self._send(self.server.site.answer(url.path, query.get("field", [None])[0]))

    def do_HEAD(self) -> None:
        """Answer a request for the headers."""
        self.do_GET()

    def _cookie(self) -> str:
        pairs = (pair.strip().partition("=") for pair in (self.headers.get("Cookie") or "").split(";"))
        return next((value for name, _, value in pairs if name == self.server.cookie), "")

    def _is_secret(self, text: str) -> bool:
        return hmac.compare_digest(text.encode("utf-8", "backslashreplace"), self.server.token.encode())

    def _send(self, answer: Answer, more: dict[str, str] | None = None) -> None:
        policy = {"Content-Security-Policy": self.server.site.policy} if answer.kind == HTML else {}
        with suppress(ConnectionError):  # the page was closed meanwhile
            self.send_response(answer.status)
            headers = {"Content-Type": answer.kind, "Content-Length": str(len(answer.body))}
            for name, value in {**headers, **_HEADERS, **policy, **answer.headers, **(more or {})}.items():
                self.send_header(name, value)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(answer.body)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""

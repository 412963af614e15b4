"""A small HTTP server with ranges, whose answers to single files are replaced by faults; and a fake hub."""

import json
import logging
import socket
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

#: An answer instead of the file: called with the handler and the file's bytes; True if it has answered.
Fault = Callable[["Handler", bytes], bool]


def raw(data: bytes) -> Fault:
    """Send these bytes in place of an answer, and close."""

    def answer(handler: "Handler", _: bytes) -> bool:
        handler.wfile.write(data)
        handler.close_connection = True
        return True

    return answer


class Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.folder = folder
        self.faults: dict[str, list[Fault]] = {}
        self.requests: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.headers: list[tuple[str, dict[str, str]]] = []
        self.ranges = True
        #: Status and headers of the last answer without a body.
        self.last: tuple[int, dict[str, str]] = 200, {}
        self.connections: list[socket.socket] = []

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        self.connections.append(request)
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.connections.remove(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        pass  # clients that go away

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    def fault(self, name: str, *answers: Fault) -> None:
        """Answer the next requests for a file by these, in this order; then as usual."""
        self.faults[name] = list(answers)

    def file_of(self, path: str) -> Path | None:
        file = self.folder / path.lstrip("/")
        return file if file.is_file() else None

    def answer(self, handler: "Handler", path: str) -> bool:
        """Answer requests that are not for files."""
        return False


class Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # else 40 ms for each answer

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def do_GET(self) -> None:
        path = unquote(urlsplit(self.path).path)
        name = path.rsplit("/", 1)[-1]
        self.server.requests[name] += 1
        self.server.headers.append((path, {name.title(): value for name, value in self.headers.items()}))
        if self.server.answer(self, path):
            return
        file = self.server.file_of(path)
        data = file.read_bytes() if file is not None else b""
        faults = self.server.faults.get(name)
        if faults and faults.pop(0)(self, data):
            return
        if file is None:
            self.status(404)
            return
        self.give(data)

    def do_HEAD(self) -> None:
        """Answer as the last time."""
        code, headers = self.server.last
        self.status(code, **headers)

    def status(self, code: int, **headers: str) -> None:
        self.server.last = code, headers
        self.send_response(code)
        for key, value in headers.items():
            self.send_header(key.replace("_", "-"), value)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def asked(self, size: int) -> tuple[int, int]:
        """Return the first byte that is asked for, and the one after the last."""
        first, _, last = self.headers.get("Range", "bytes=0-").removeprefix("bytes=").partition("-")
        return int(first), min(size, int(last) + 1) if last else size

    def head(self, data: bytes) -> bytes | None:
        """Send status and headers; return the bytes that were asked for."""
        begin, end = self.asked(len(data)) if self.server.ranges else (0, len(data))
        if begin >= len(data):
            self.status(416)
            return None
        if "Range" in self.headers and self.server.ranges:
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {begin}-{end - 1}/{len(data)}")
        else:
            self.send_response(200)
        self.send_header("Content-Length", str(end - begin))
        self.send_header("ETag", '"1"')  # as clients of buckets need it
        self.send_header("Last-Modified", "Wed, 21 Oct 2015 07:28:00 GMT")
        self.end_headers()
        return data[begin:end]

    def give(self, data: bytes, *, only: int | None = None) -> None:
        """Send the bytes that were asked for; `only` so many of them, and then cut the connection."""
        body = self.head(data)
        if body is None:
            return
        body = body[:only]
        self.server.sent[self.path.rsplit("/", 1)[-1]] += len(body)  # before a client that has it can look
        self.wfile.write(body)
        if only is not None:
            self.wfile.flush()
            self.close_connection = True


def status(code: int, **headers: str) -> Fault:
    return lambda handler, data: (handler.status(code, **headers), True)[1]


def cut(n: int) -> Fault:
    """Send n bytes of the announced ones, and close."""
    return lambda handler, data: (handler.give(data, only=n), True)[1]


def other(data: Callable[[bytes], bytes]) -> Fault:
    """Send other bytes."""
    return lambda handler, original: (handler.give(data(original)), True)[1]


@contextmanager
def serving(server: Server) -> Iterator[Server]:
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        for connection in [*server.connections]:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)  # clients keep theirs for a next request
        for _ in range(100):
            if server.connections:
                time.sleep(0.01)


class Hub(Server):
    """A fake hub with one dataset repository, ORG/NAME, whose folder is the content at the newest commit."""

    def __init__(self, folder: Path, token: str = "") -> None:
        super().__init__(folder)
        self.token, self.gated = token, False
        self.commits = {"a" * 40: folder}
        self.branches = {"main": "a" * 40}

    def answer(self, handler: Handler, path: str) -> bool:
        parts = path.strip("/").split("/")
        api = parts[0] == "api"
        repository, rest = "/".join(parts[2:4] if api else parts[1:3]), parts[4:] if api else parts[3:]
        if repository != "org/name":
            handler.status(404 if self.token else 401, X_Error_Code="RepoNotFound")
        elif self.token and handler.headers.get("Authorization") != f"Bearer {self.token}":
            handler.status(401)
        elif self.gated:
            handler.status(403, X_Error_Code="GatedRepo")
        elif len(rest) < 2 or (commit := self.commit_of(rest[1])) not in self.commits:
            handler.status(404, X_Error_Code="RevisionNotFound")
        elif api:
            body = json.dumps({"id": repository, "sha": commit}).encode()
            handler.send_response(200)
            handler.send_header("Content-Length", str(len(body)))
            handler.end_headers()
            handler.wfile.write(body)
        elif not (self.commits[commit] / "/".join(rest[2:])).is_file():
            handler.status(404, X_Error_Code="EntryNotFound")
        else:
            return False
        return True

    def file_of(self, path: str) -> Path | None:
        parts = path.strip("/").split("/")
        return self.commits[self.commit_of(parts[4])] / "/".join(parts[5:])

    def commit_of(self, revision: str) -> str:
        return self.branches.get(revision, revision)


#: Credentials and region of a bucket, as clients of S3 read them.
S3 = {
    "AWS_ALLOW_HTTP": "true", "AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "s3cr3tOfTheBucket",
    "AWS_REGION": "us-east-1",
}  # fmt: skip


@contextmanager
def moto_bucket(folder: Path, prefix: str) -> Iterator[dict[str, str]]:
    """Serve the files of a folder as s3://dances/PREFIX/...; yield the environment that clients need."""
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name in ("", *(f"/{prefix}/{p.name}" for p in folder.iterdir())):
        data = (folder / name.rsplit("/", 1)[-1]).read_bytes() if name else b""
        headers = {"Content-Type": "binary/octet-stream"}
        request = urllib.request.Request(f"http://{host}:{port}/dances{name}", data, headers, method="PUT")
        urllib.request.urlopen(request, timeout=60).close()
    yield {**S3, "AWS_ENDPOINT": f"http://{host}:{port}"}
    server.stop()

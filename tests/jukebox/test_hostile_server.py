"""A server that answers what no server should: fetch ends with a clear error, and takes no more than the file has."""

import hashlib
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from dancedata.audio.jukebox import fetch
from dancedata.audio.jukebox.weights.download import FILES, RemoteFile
from dancedata.core.errors import SourceError

DATA = b"weights" * 10_000
FILE = RemoteFile("a.bin", len(DATA), hashlib.sha256(DATA).hexdigest())
UNKNOWN = RemoteFile("a.bin", None, FILE.sha256, max_size=100_000)
OK = b"HTTP/1.1 200 OK\r\n"

Answer = Callable[[socket.socket], None]


class Server:
    """Reads a request and answers with the given bytes."""

    def __init__(self) -> None:
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.answers: list[Answer] = []
        self.asked: list[bytes] = []
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.listening.getsockname()[1]}/"

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self.listening.accept()
                with client, suppress(OSError):
                    self.asked.append(client.recv(65_536))
                    (self.answers.pop(0) if len(self.answers) > 1 else self.answers[0])(client)


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.listening.close()


def answer_of(data: bytes) -> Answer:
    return lambda client: client.sendall(data)


def without_end(client: socket.socket) -> None:
    client.sendall(OK + b"\r\n")
    while True:
        client.sendall(bytes(1 << 16))


def get(server: Server, out: Path, file: RemoteFile = FILE, attempts: int = 1) -> Path:
    (path,) = fetch(out, server.url, accept_licence=True, files=[file], attempts=attempts, wait_s=0)
    return path


def left(out: Path) -> list[str]:
    return sorted(p.name for p in out.iterdir() if not p.name.endswith(".lock"))


@pytest.mark.parametrize("length", [b"abc", b"-5", b"1e9", b"9" * 5000, b"70000, 70000", b"\xff", b""])
def test_invalid_lengths_are_not_believed(server: Server, tmp_path: Path, length: bytes) -> None:
    server.answers = [answer_of(OK + b"Content-Length: " + length + b"\r\n\r\n" + DATA)]
    assert get(server, tmp_path).read_bytes() == DATA


@pytest.mark.parametrize("file", [FILE, UNKNOWN], ids=["size known", "size unknown"])
def test_a_body_without_an_end(server: Server, tmp_path: Path, file: RemoteFile) -> None:
    server.answers = [without_end]
    with pytest.raises(SourceError, match=rf"another file; found more than that; allowed: .*{file.limit} bytes"):
        get(server, tmp_path, file)
    assert left(tmp_path) == []


def test_a_length_beyond_the_size_of_the_file(server: Server, tmp_path: Path) -> None:
    server.answers = [answer_of(OK + b"Content-Length: 100001\r\n\r\n")]
    with pytest.raises(SourceError, match="found 100001 bytes; allowed: at most 100000 bytes"):
        get(server, tmp_path, UNKNOWN)


def test_the_small_file_of_unknown_size_is_bounded() -> None:
    assert [file.limit < 20_000_000 for file in FILES if file.size is None] == [True]


@pytest.mark.parametrize(
    "answer",
    [b"", b"HTTP/9.9 abc\r\n\r\n", b"HTTP/1.1 99999999999 x\r\n\r\n",
     b"HTTP/1.1 404 \x1b[2J\x9b" + b"x" * 60_000 + b"\r\n\r\n", OK + b"x" * 70_000 + b"\r\n\r\n",
     OK + b"Transfer-Encoding: chunked\r\n\r\nzzz\r\n", b"HTTP/1.1 302 x\r\nLocation: file:///etc/passwd\r\n\r\n",
     b"HTTP/1.1 302 x\r\nLocation: ftp://127.0.0.1/x\r\n\r\n",
     b"HTTP/1.1 302 x\r\nLocation: http://127.0.0.1:abc/\r\n\r\n",
     b"HTTP/1.1 302 x\r\nLocation: http://[/\r\n\r\n",
     b"HTTP/1.1 302 x\r\nLocation: http://\xff\xfe\x01/\r\n\r\n",
     b"HTTP/1.1 302 x\r\nLocation: /\xe9 \x0b\r\n\r\n", b"HTTP/1.1 206 x\r\nContent-Range: \x1b[2J\r\n\r\n",
     b"HTTP/1.1 416 x\r\n\r\n"],
)  # fmt: skip
def test_invalid_answers(server: Server, tmp_path: Path, answer: bytes) -> None:
    server.answers = [answer_of(answer)]
    with pytest.raises(SourceError) as error:
        get(server, tmp_path)
    text = str(error.value)
    assert text.replace("\n", "").isprintable()
    assert len(text) < 800

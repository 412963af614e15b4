"""Downloads from a server on localhost that cuts connections, lacks ranges, changes the file, or lies."""

import hashlib
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.audio.jukebox import fetch
from dancedata.audio.jukebox.weights.download import FILES, RemoteFile
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from tests.messages import raises_message

DATA = np.random.default_rng(0).bytes(3_000_000)


def _remote(name: str = "a.bin", data: bytes = DATA) -> RemoteFile:
    return RemoteFile(name, len(data), hashlib.sha256(data).hexdigest())


class _Server(ThreadingHTTPServer):
    """Serves DATA under every name; its attributes choose its faults."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.data = DATA
        self.cut_after: list[int] = []  # bytes of the body of the next answers, each followed by a closed connection
        self.ranges = True
        self.shift = 0
        self.length = True
        self.status: list[int] = []
        self.asked: list[str | None] = []

    def handle_error(self, *_: object) -> None:
        """Print nothing: lost clients are part of the tests."""

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/models/"


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        server, wanted = self.server, self.headers.get("Range")
        server.asked.append(wanted)
        if server.status:
            self.send_error(server.status.pop(0))
            return
        start = int(wanted.removeprefix("bytes=").removesuffix("-")) if wanted and server.ranges else 0
        if start >= len(server.data):
            self.send_error(416)
            return
        self.send_response(206 if start else 200)
        if start:
            start -= server.shift
            self.send_header("Content-Range", f"bytes {start}-{len(server.data) - 1}/{len(server.data)}")
        body = server.data[start:]
        if server.length:
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: server.cut_after.pop(0)] if server.cut_after else body)
        self.close_connection = True


@pytest.fixture
def server() -> Iterator[_Server]:
    with _Server() as running:
        thread = threading.Thread(target=running.serve_forever, args=(0.01,))
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def _fetch(out: Path, source: object, file: RemoteFile | None = None, **more: Any) -> Path:
    (path,) = fetch(out, str(source), accept_licence=True, files=[file or _remote()], wait_s=0, **more)
    return path


def _left(out: Path) -> list[str]:
    return sorted(p.name for p in out.iterdir() if not p.name.endswith(".lock"))


def test_whole_file_with_progress(server: _Server, tmp_path: Path) -> None:
    seen: list[tuple[str, int, int | None]] = []
    path = _fetch(tmp_path / "new", server.url, progress=lambda *what: seen.append(what))
    assert path.read_bytes() == DATA
    assert _left(tmp_path / "new") == ["a.bin"]
    assert seen[-1] == ("a.bin", len(DATA), len(DATA))
    # The second time the file is checked and nothing is requested.
    _fetch(tmp_path / "new", server.url)
    path.write_bytes(b"x")
    with raises_message(SourceError, "differs", where="a.bin"):
        _fetch(tmp_path / "new", server.url)
    assert len(server.asked) == 1


def test_resumes_after_a_lost_connection(server: _Server, tmp_path: Path) -> None:
    server.cut_after = [1_000_000, 0, 500_000]
    assert _fetch(tmp_path, server.url).read_bytes() == DATA
    first, *begins = (int((wanted or "bytes=0-")[6:-1]) for wanted in server.asked)
    # What a connection has sent of its last 16 KiB is asked for again.
    assert [first, *(round(begin, -5) for begin in begins)] == [0, 1_000_000, 1_000_000, 1_500_000]


def test_a_partial_download_of_another_program_stays(server: _Server, tmp_path: Path) -> None:
    for name in ("a.bin.part", ".a.bin.lock"):
        (tmp_path / name).write_bytes(b"mine")
    assert _fetch(tmp_path, server.url).read_bytes() == DATA
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [".a.bin.lock", "a.bin", "a.bin.part"]
    assert all((tmp_path / name).read_bytes() == b"mine" for name in names if name != "a.bin")


def test_gives_up_but_keeps_the_partial_file(server: _Server, tmp_path: Path) -> None:
    server.cut_after = [700_000, 0, 0, 0, 0]
    with pytest.raises(SourceError, match=r"failed; found .*IncompleteRead.*; \d{6} bytes downloaded"):
        _fetch(tmp_path, server.url, attempts=3)
    assert _left(tmp_path) == [".dancedata-a.bin.part"]
    server.cut_after = []
    assert _fetch(tmp_path, server.url).read_bytes() == DATA
    assert server.asked[-1] not in (None, "bytes=0-")
    assert _left(tmp_path) == ["a.bin"]


@pytest.mark.parametrize(
    "faults",
    [{"status": [503, 500]}, {"ranges": False, "cut_after": [1_000_000]}, {"length": False},
     {"length": False, "cut_after": [1000]}],
    ids=["temporary", "no ranges", "no length", "no length, cut"],
)  # fmt: skip
def test_faults_that_pass(server: _Server, tmp_path: Path, faults: dict[str, Any]) -> None:
    vars(server).update(faults)
    assert _fetch(tmp_path, server.url).read_bytes() == DATA
    assert _left(tmp_path) == ["a.bin"]


@pytest.mark.parametrize(
    ("faults", "word", "asked"),
    [
        ({"status": [404]}, r"models/a\.bin: .* found 404", 1),
        ({"shift": 5, "cut_after": [1_000_000]}, r"asked for bytes from .*, got 'bytes ", 2),
    ],
)
def test_faults_that_stay(server, tmp_path, faults, word, asked):
    vars(server).update(faults)
    with raises_message(SourceError, word):
        _fetch(tmp_path, server.url, attempts=2)
    assert len(server.asked) == asked


def test_a_part_of_another_file_is_found_by_the_hash(server: _Server, tmp_path: Path) -> None:
    (tmp_path / ".dancedata-a.bin.part").write_bytes(b"other")
    with raises_message(SourceError, "differs"):
        _fetch(tmp_path, server.url)
    assert _fetch(tmp_path, server.url).read_bytes() == DATA


def test_complete_part_is_only_checked(server: _Server, tmp_path: Path) -> None:
    (tmp_path / ".dancedata-a.bin.part").write_bytes(DATA)
    assert _fetch(tmp_path, server.url).read_bytes() == DATA


@pytest.mark.parametrize(
    ("size", "sha256", "faults", "word", "left"),
    [
        (7, _remote().sha256, {}, "another file; found 3000000 bytes; allowed: 7 bytes", []),
        (len(DATA), "0" * 64, {}, "renamed", [".dancedata-a.bin.mismatch"]),
        # Without a stated length and size the hash tells.
        (None, _remote().sha256, {"length": False, "cut_after": [1000]}, "differs", []),
    ],
)
def test_another_file_is_set_aside(server, tmp_path, size, sha256, faults, word, left):
    vars(server).update(faults)
    with raises_message(SourceError, word):
        _fetch(tmp_path, server.url, RemoteFile("a.bin", size, sha256))
    assert _left(tmp_path) == left
    assert all((tmp_path / name).read_bytes() == DATA for name in left)


def test_no_server_listens(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="download failed"):
        _fetch(tmp_path, "http://127.0.0.1:9/", attempts=2)


def test_from_a_folder(tmp_path: Path) -> None:
    (tmp_path / "from").mkdir()
    (tmp_path / "from" / "a.bin").write_bytes(DATA)
    assert _fetch(tmp_path / "to", tmp_path / "from").read_bytes() == DATA
    (tmp_path / "from" / "a.bin").write_bytes(DATA[:-1])
    with raises_message(SourceError, "differs", where="from/a.bin"):
        _fetch(tmp_path / "to2", tmp_path / "from")
    assert (tmp_path / "from" / "a.bin").exists()
    with raises_message(SourceError, r"a\.bin", where="from/b.bin"):
        _fetch(tmp_path / "to2", tmp_path / "from", _remote("b.bin"))


@pytest.mark.parametrize("source", ["ftp://example.org/x", "/no/such/folder", "file:///etc"])
def test_other_sources(tmp_path: Path, source: str) -> None:
    with raises_message(UsageError, "local"):
        _fetch(tmp_path, source)


def test_licence_comes_first(server: _Server, tmp_path: Path) -> None:
    shown: list[str] = []

    def ask(text: str) -> bool:
        shown.append(text)
        return False

    for answer in (ask, False):
        with raises_message(UsageError, "accepted"):
            fetch(tmp_path / "out", server.url, accept_licence=answer, files=[_remote()])
    assert "Noncommercial" in shown[0]
    assert server.asked == []
    assert not (tmp_path / "out").exists()


def test_two_programs_at_once(server: _Server, tmp_path: Path) -> None:
    from dancedata.files.locks import file_lock

    with file_lock(tmp_path / ".dancedata-a.bin.lock"), raises_message(UsageError, "fetching", where="a.bin"):
        _fetch(tmp_path, server.url)


def test_disk_that_cannot_be_written(server: _Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(DanceDataError, match=r"a\.bin: .* cannot be written; found .*No space left.* GB are free"):
        _fetch(tmp_path, server.url, progress=full)


def test_the_real_files() -> None:
    assert [f.name for f in FILES] == ["vqvae.pth.tar", "prior_level_2.pth.tar"]
    assert all(len(f.sha256) == 64 for f in FILES)

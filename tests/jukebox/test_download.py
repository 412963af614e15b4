"""Downloads from a server that cuts connections, lacks ranges, lies, or answers what no server should."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.audio.jukebox import fetch
from dancedata.audio.jukebox.weights.download import FILES, RemoteFile
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.files.locks import file_lock
from tests.commands import as_json
from tests.messages import raises_message
from tests.remote.servers import Fault, Handler, Server, cut, raw, serving, status

DATA = np.random.default_rng(0).bytes(3_000_000)
OK = b"HTTP/1.1 200 OK\r\n"


def _remote(name: str = "a.bin", size: int | None = len(DATA), **more: Any) -> RemoteFile:
    return RemoteFile(name, size, **{"sha256": hashlib.sha256(DATA).hexdigest(), **more})


UNKNOWN = _remote(size=None, max_size=4_000_000)


def without_end(handler: Handler, _: bytes) -> bool:
    handler.wfile.write(OK + b"\r\n")
    while True:
        handler.wfile.write(bytes(1 << 16))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    (folder / "a.bin").write_bytes(DATA)
    return folder


@pytest.fixture
def server(folder: Path) -> Iterator[Server]:
    with serving(Server(folder)) as running:
        yield running


def _fetch(out: Path, source: Server | Path | str, file: RemoteFile | None = None, **more: Any) -> Path:
    source = source.url if isinstance(source, Server) else str(source)
    (path,) = fetch(out, source, accept_licence=True, files=[file or _remote()], wait_s=0, **more)
    return path


def _ranges(server: Server) -> list[int]:
    """Return the first byte that each request asked for."""
    return [int(headers.get("Range", "bytes=0-")[6:-1]) for _, headers in server.headers]


def _left(out: Path) -> list[str]:
    return sorted(p.name for p in out.iterdir() if not p.name.endswith(".lock"))


def test_whole_file_with_progress(server: Server, tmp_path: Path) -> None:
    seen: list[tuple[str, int, int | None]] = []
    path = _fetch(tmp_path / "new", server, progress=lambda *what: seen.append(what))
    assert path.read_bytes() == DATA
    assert _left(tmp_path / "new") == ["a.bin"]
    assert seen[-1] == ("a.bin", len(DATA), len(DATA))
    # The second time the file is checked and nothing is requested.
    _fetch(tmp_path / "new", server)
    path.write_bytes(b"x")
    with raises_message(SourceError, "differs", where="a.bin"):
        _fetch(tmp_path / "new", server)
    assert len(server.headers) == 1


def test_resumes_after_a_lost_connection(server: Server, tmp_path: Path) -> None:
    server.fault("a.bin", cut(1_000_000), cut(0), cut(500_000))
    assert _fetch(tmp_path, server).read_bytes() == DATA
    # What a connection has sent of its last 16 KiB is asked for again.
    assert [round(begin, -5) for begin in _ranges(server)] == [0, 1_000_000, 1_000_000, 1_500_000]


def test_a_partial_download_of_another_program_stays(server: Server, tmp_path: Path) -> None:
    for name in ("a.bin.part", ".a.bin.lock"):
        (tmp_path / name).write_bytes(b"mine")
    assert _fetch(tmp_path, server).read_bytes() == DATA
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [".a.bin.lock", "a.bin", "a.bin.part"]
    assert all((tmp_path / name).read_bytes() == b"mine" for name in names if name != "a.bin")


def test_gives_up_but_keeps_the_partial_file(server: Server, tmp_path: Path) -> None:
    server.fault("a.bin", cut(700_000), *[cut(0)] * 3)
    with pytest.raises(SourceError, match=r"failed; found .*IncompleteRead.*; \d{6} bytes downloaded"):
        _fetch(tmp_path, server, attempts=3)
    assert _left(tmp_path) == [".dancedata-a.bin.part"]
    server.fault("a.bin")
    assert _fetch(tmp_path, server).read_bytes() == DATA
    assert _ranges(server)[-1] > 0
    assert _left(tmp_path) == ["a.bin"]


@pytest.mark.parametrize(
    ("ranges", "answers"),
    [(True, [status(503), status(500)]), (False, [cut(1_000_000)]), (True, [raw(OK + b"\r\n" + DATA)]),
     (True, [raw(OK + b"\r\n" + DATA[:1000])])],
    ids=["temporary", "no ranges", "no length", "no length, cut"],
)  # fmt: skip
def test_faults_that_pass(server: Server, tmp_path: Path, ranges: bool, answers: list[Fault]) -> None:
    server.ranges = ranges
    server.fault("a.bin", *answers)
    assert _fetch(tmp_path, server).read_bytes() == DATA
    assert _left(tmp_path) == ["a.bin"]


@pytest.mark.parametrize(
    ("answers", "word"),
    [
        ([status(404)], r"a\.bin: .* found 404"),
        (
            [cut(1_000_000), raw(b"HTTP/1.1 206 x\r\nContent-Range: bytes 5-9/10\r\n\r\n")],
            "asked for bytes from .*, got",
        ),
    ],
)
def test_faults_that_stay(server: Server, tmp_path: Path, answers: list[Fault], word: str) -> None:
    server.fault("a.bin", *answers)
    with raises_message(SourceError, word):
        _fetch(tmp_path, server, attempts=2)
    assert len(server.headers) == len(answers)


def test_a_part_of_another_file_is_found_by_the_hash_and_a_whole_one_only_checked(
    server: Server, tmp_path: Path
) -> None:
    part = tmp_path / ".dancedata-a.bin.part"
    part.write_bytes(b"other")
    with raises_message(SourceError, "differs"):
        _fetch(tmp_path, server)
    part.write_bytes(DATA)
    assert _fetch(tmp_path, server).read_bytes() == DATA


@pytest.mark.parametrize(
    ("file", "answers", "word", "left"),
    [
        (_remote(size=7), [], "another file; found 3000000 bytes; allowed: 7 bytes", []),
        (_remote(sha256="0" * 64), [], "renamed", [".dancedata-a.bin.mismatch"]),
        # Without a stated length and size the hash tells.
        (_remote(size=None), [raw(OK + b"\r\n" + DATA[:1000])], "differs", []),
        (_remote(), [without_end], "another file; found more than that; allowed: 3000000 bytes", []),
        (UNKNOWN, [without_end], "another file; found more than that; allowed: at most 4000000 bytes", []),
        (UNKNOWN, [raw(OK + b"Content-Length: 4000001\r\n\r\n")], "4000001 bytes; allowed: at most 4000000", []),
    ],
)
def test_another_file_is_set_aside(server, tmp_path, file, answers, word, left):
    server.fault("a.bin", *answers)
    with raises_message(SourceError, word):
        _fetch(tmp_path, server, file)
    assert _left(tmp_path) == left
    assert all((tmp_path / name).read_bytes() == DATA for name in left)


@pytest.mark.parametrize("length", [b"abc", b"-5", b"1e9", b"9" * 5000, b"3000000, 3000000", b"\xff", b""])
def test_invalid_lengths_are_not_believed(server: Server, tmp_path: Path, length: bytes) -> None:
    server.fault("a.bin", raw(OK + b"Content-Length: " + length + b"\r\n\r\n" + DATA))
    assert _fetch(tmp_path, server, attempts=1).read_bytes() == DATA


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
    server.fault("a.bin", raw(answer))
    with pytest.raises(SourceError) as error:
        _fetch(tmp_path, server, attempts=1)
    text = str(error.value)
    assert text.replace("\n", "").isprintable()
    assert len(text) < 800


def test_no_server_listens(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="download failed"):
        _fetch(tmp_path, "http://127.0.0.1:9/", attempts=2)


def test_from_a_folder(folder: Path, tmp_path: Path) -> None:
    assert _fetch(tmp_path / "to", folder).read_bytes() == DATA
    with raises_message(SourceError, r"a\.bin", where="b.bin"):
        _fetch(tmp_path / "to2", folder, _remote("b.bin"))
    (tmp_path / "a.bin").write_bytes(DATA[:-1])
    with raises_message(SourceError, "differs", where="a.bin"):
        _fetch(tmp_path / "to2", tmp_path)
    assert (tmp_path / "a.bin").exists()


@pytest.mark.parametrize("source", ["ftp://example.org/x", "/no/such/folder", "file:///etc"])
def test_other_sources(tmp_path: Path, source: str) -> None:
    with raises_message(UsageError, "local"):
        _fetch(tmp_path, source)


def test_licence_comes_first(server: Server, tmp_path: Path) -> None:
    shown: list[str] = []

    def ask(text: str) -> bool:
        shown.append(text)
        return False

    for answer in (ask, False):
        with raises_message(UsageError, "accepted"):
            fetch(tmp_path / "out", server.url, accept_licence=answer, files=[_remote()])
    assert "Noncommercial" in shown[0]
    assert server.headers == []
    assert not (tmp_path / "out").exists()


def test_the_command(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(fetch.__kwdefaults__, "files", [_remote()])
    assert "accepted" in as_json("pull", folder, "--out", tmp_path / "out", code=2)["problem"]
    assert "weights" in as_json("pull", "nothing", "--out", tmp_path / "out", code=2)["problem"]
    assert not (tmp_path / "out").exists()
    fetched = as_json("pull", folder, "--out", tmp_path / "out", "--accept-licence")
    assert fetched == {"path": str(tmp_path / "out"), "files": ["a.bin"], "bytes": len(DATA)}


def test_two_programs_at_once(server: Server, tmp_path: Path) -> None:
    with file_lock(tmp_path / ".dancedata-a.bin.lock"), raises_message(UsageError, "fetching", where="a.bin"):
        _fetch(tmp_path, server)


def test_disk_that_cannot_be_written(server: Server, tmp_path: Path) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(DanceDataError, match=r"a\.bin: .* cannot be written; found .*No space left.* GB are free"):
        _fetch(tmp_path, server, progress=full)


def test_the_real_files_are_bounded() -> None:
    assert [f.name for f in FILES] == ["vqvae.pth.tar", "prior_level_2.pth.tar"]
    assert all(len(f.sha256) == 64 for f in FILES)
    assert [file.limit < 20_000_000 for file in FILES if file.size is None] == [True]

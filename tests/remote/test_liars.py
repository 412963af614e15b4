"""Servers that lie, under open and pull: each an error, nothing of theirs kept, and no hang."""

import gzip
import json
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.core.errors import StoreError
from dancedata.core.hashing import json_sha256
from dancedata.files.addresses import local_folder
from dancedata.remote import client, fetch, source
from dancedata.remote.pull import pull
from tests.remote.servers import S3, Fault, Handler, Hub, Server, cut, other, raw, serving, status

Way = Callable[[str], object]


def _row(address: str) -> object:
    store = dancedata.open(address)
    return store.read(store.windows("train")[0], "pose")


WAYS: dict[str, Way] = {"open": _row, "pull": lambda address: pull(address, progress=False)}


def _wait_for(monkeypatch: pytest.MonkeyPatch, silence: float, stall: float, attempts: int) -> None:
    monkeypatch.setattr(client, "TIMEOUT_S", silence)
    monkeypatch.setattr(source, "STALL_S", stall)
    monkeypatch.setattr(fetch, "ATTEMPTS", attempts)


@pytest.fixture(autouse=True)
def no_hang(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Wait shortly, and fail instead of hanging."""
    _wait_for(monkeypatch, 0.4, 0.2, 2)

    def hangs(*_: object) -> None:
        raise TimeoutError("it hangs")

    signal.signal(signal.SIGALRM, hangs)
    signal.alarm(120)
    yield
    signal.alarm(0)


def _head(handler: Handler, code: int, **headers: str) -> None:
    handler.send_response(code)
    for name, value in headers.items():
        handler.send_header(name.replace("_", "-"), value)
    handler.end_headers()


def _endless(handler: Handler, chunk: bytes, pause: float = 0.0) -> bool:
    """Send a chunk again and again, until the client has gone."""
    handler.close_connection = True
    end = time.monotonic() + 30
    while time.monotonic() < end:
        handler.wfile.write(chunk)
        handler.wfile.flush()
        time.sleep(pause)
    return True


def _with(body: Callable[[bytes], bytes], **headers: str) -> Fault:
    """Answer 200 or 206 with these headers instead of the right ones."""

    def answer(handler: Handler, data: bytes) -> bool:
        begin, end = handler.asked(len(data))
        ranged = "Range" in handler.headers
        sent = body(data[begin:end])
        known = {"Content_Length": str(len(sent)), **headers}
        if ranged:
            known.setdefault("Content_Range", f"bytes {begin}-{end - 1}/{len(data)}")
        _head(handler, 206 if ranged else 200, **known)
        handler.wfile.write(sent)
        handler.close_connection = True
        return True

    return answer


def _begun(handler: Handler, data: bytes, **headers: str) -> bytes:
    begin, end = handler.asked(len(data))
    ranged = {"Content_Range": f"bytes {begin}-{end - 1}/{len(data)}"} if "Range" in handler.headers else {}
    _head(handler, 206 if ranged else 200, **headers, **ranged)
    return data[begin:end]


def _chunked(handler: Handler, data: bytes) -> bool:
    _begun(handler, data, Transfer_Encoding="chunked")
    return _endless(handler, b"10000\r\n" + bytes(1 << 16) + b"\r\n")


def _drip(handler: Handler, data: bytes) -> bool:
    begin, end = handler.asked(len(data))
    _begun(handler, data, Content_Length=str(end - begin))
    return _endless(handler, b"x", 0.02)


def _chunk_size_that_does_not_end(handler: Handler, data: bytes) -> bool:
    _begun(handler, data, Transfer_Encoding="chunked")
    return _endless(handler, b"0", 0.02)


def _trailers_that_do_not_end(handler: Handler, data: bytes) -> bool:
    body = _begun(handler, data, Transfer_Encoding="chunked")
    handler.wfile.write(b"%x\r\n" % 9 + body[:9] + b"\r\n0\r\n")
    return _endless(handler, b"X-Trailer: 1\r\n" * 1000)


LIES: dict[str, Fault] = {
    "more than the length": _with(lambda data: data + bytes(999_999)),
    "a length that is not a number": _with(lambda data: data[:-9], Content_Length="many"),
    "gzip": _with(gzip.compress, Content_Encoding="gzip"),
    "other bytes": other(lambda data: bytes(len(data))),
    "nothing": raw(b""),
    "no HTTP": raw(b"SSH-2.0-OpenSSH_9.6\r\n"),
    "a status that is not a number": raw(b"HTTP/1.1 two hundred OK\r\n\r\n"),
    "ten thousand headers": raw(b"HTTP/1.1 200 OK\r\n" + b"A: b\r\n" * 10_000 + b"\r\n"),
    "a head that does not end": lambda handler, _: _endless(handler, b"HTTP/1.1 200 OK" + b"\r\nA: b" * 50, 0.01),
    "a head byte by byte": lambda handler, _: _endless(handler, b"H", 0.02),
    "continue, continue": lambda handler, _: _endless(handler, b"HTTP/1.1 100 Continue\r\n\r\n" * 100),
    "chunks without end": _chunked,
    "a chunk's size without end": _chunk_size_that_does_not_end,
    "trailers without end": _trailers_that_do_not_end,
    "byte by byte": _drip,
    "206 from elsewhere": _with(lambda data: data, Content_Range="bytes 5-9/10"),
    "206 without a place": _with(lambda data: data, Content_Range=""),
    "a redirection to a file": status(302, Location="file:///etc/passwd"),
    "a redirection to another host": status(307, Location="http://198.51.100.1/store"),
    "a redirection to nothing": status(308, Location=""),
    "a redirection that is no address": status(302, Location="http://[::1"),
    "redirections without end": lambda handler, _: (handler.status(302, Location=handler.path), True)[1],
    "204": status(204),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("way", WAYS)
def test_lies_about_a_shard(server, published, way, lie, monkeypatch):
    address = f"{server.url}/store"
    name = next(p.name for p in sorted(published.iterdir()) if p.name.startswith("train-00000-of"))
    server.fault(name, *[LIES[lie]] * 99)
    if lie.startswith("206"):  # they are no answers to ranges
        WAYS[way](address)
    else:
        _wait_for(monkeypatch, 0.15, 0.1, 2)  # in vain
        with pytest.raises(StoreError) as caught:
            WAYS[way](address)
        assert name in str(caught.value) or "redirects" in str(caught.value)
        assert "root:" not in str(caught.value)
    server.faults.clear()
    _wait_for(monkeypatch, 30.0, 60.0, 6)
    folder = pull(address, progress=False).path  # what was fetched before is right, or was not kept
    assert all((folder / p.name).read_bytes() == p.read_bytes() for p in published.iterdir() if p.name != "README.md")


@pytest.mark.parametrize("lie", LIES)
def test_lies_about_the_description(server, lie, own_cache, monkeypatch):
    server.fault("dataset.json", *[LIES[lie]] * 99)
    if lie.startswith("206"):
        assert local_folder(f"{server.url}/store")
        return
    _wait_for(monkeypatch, 0.15, 0.1, 2)
    with pytest.raises(StoreError):
        local_folder(f"{server.url}/store")
    assert not list(own_cache.rglob("dataset.json"))


def _changed(published: Path, site: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Publish a dataset whose dataset.json lies, with a hash of its own that fits."""
    shutil.copytree(published, site / "store")
    path = site / "store" / "dataset.json"
    document = json.loads(path.read_text())
    change(document)
    del document["self_sha256"]
    path.write_text(json.dumps({**document, "self_sha256": json_sha256(document)}))


SIZES = (10**18, 2**63, 10**40, -1, 1.5, True, None, "9")
NAMES = ("../x-00000-of-00001.h5", "/etc/passwd", "a/b.h5", "..", "dataset.json", "a\0b.h5")


@pytest.mark.parametrize(("key", "value"), [*(("size", size) for size in SIZES), *(("file", name) for name in NAMES)])
def test_sizes_that_are_none_and_names_that_lead_out(server, published, tmp_path, key, value):
    _changed(published, tmp_path / "site", lambda d: d["shards"][0].update({key: value}))
    server.folder = tmp_path / "site"
    with pytest.raises(StoreError):
        pull(f"{server.url}/store", progress=False)
    assert not [p for p in tmp_path.rglob("*") if p.name.startswith(("x-", "passwd")) or p.name == "b.h5"]


@pytest.mark.parametrize("way", WAYS)
def test_a_file_that_is_shorter_than_it_should_be(server: Server, published: Path, tmp_path: Path, way: str) -> None:
    """A part of it is discarded when the server has no more, comes again, and so on: that is no progress."""
    shutil.copytree(published, tmp_path / "site" / "store")
    path = next(iter(sorted((tmp_path / "site" / "store").glob("train-00000-of*"))))
    path.write_bytes(path.read_bytes()[:-5])
    server.folder = tmp_path / "site"
    with pytest.raises(StoreError, match=rf"{path.name}: "):
        WAYS[way](f"{server.url}/store")


@pytest.mark.parametrize(
    "text",
    [b"[" * 200_000, b'{"self_sha256": ' + b"9" * 10_000 + b"}", b'{"a": 1, "a": 2}', b"\xff\xfe", b"null", b"",
     b"<html>login</html>", b"{}", b"[1]", b'{"self_sha256": "abc"}'],
)  # fmt: skip
def test_descriptions_that_are_none(server: Server, text: bytes) -> None:
    server.fault("dataset.json", *[other(lambda data: text)] * 9)
    with pytest.raises(StoreError, match=r"not the dataset\.json of a finished dataset|HTTP 416"):
        local_folder(f"{server.url}/store")
    assert server.requests["dataset.json"] == 2 or not text


def test_lies_of_a_hub_about_a_commit(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    right, answers = hub.answer, []

    def answer(handler: Handler, path: str) -> bool:
        return answers.pop(0)(handler, b"") if "/api/" in path and answers else right(handler, path)

    monkeypatch.setattr(hub, "answer", answer)
    address = "hf://datasets/org/name"
    for lie, problem in {
        '{"sha": "../../../etc"}': "does not name a commit",
        '{"sha": ["a"]}': "does not name a commit",
        "[" * 100_000: "does not name a commit",
        "<html>": "does not name a commit",
        "x" * (2 << 20): "does not end",
    }.items():
        answers[:] = [_with(lambda data, lie=lie: lie.encode())]  # type: ignore[misc]
        with pytest.raises(StoreError, match=problem):
            local_folder(address)
    answers[:] = [_drip] * 9
    with pytest.raises(StoreError):
        local_folder(address)
    answers[:] = [status(503)]
    assert local_folder(address)


def test_a_server_that_asks_to_wait_is_named(server: Server, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(fetch.time, "sleep", lambda seconds: None)
    server.fault("dataset.json", status(429, Retry_After="120"))
    local_folder(f"{server.url}/store")
    assert "dataset.json: HTTP 429; waiting 120 s" in capsys.readouterr().err


def test_a_bucket_that_lies(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """obstore's client, of a server that gives other bytes, or another range than was asked for."""
    pytest.importorskip("obstore")
    fixed = {"ETag": '"1"', "Last_Modified": "Wed, 21 Oct 2015 07:28:00 GMT"}
    with serving(Server(published.parent)) as server:
        for name, value in {**S3, "AWS_ENDPOINT": server.url}.items():
            monkeypatch.setenv(name, value)
        assert _row("s3://store") is not None
        store = dancedata.open("s3://store")
        window = store.windows("val")[0]
        shard = store._locate(window, "pose").shard.path.name

        def elsewhere(handler: Handler, data: bytes) -> bool:
            _head(handler, 206, Content_Length="10", Content_Range=f"bytes 3-12/{len(data)}", **fixed)
            handler.wfile.write(data[3:13])
            return True

        wrong = _with(lambda data: bytes(len(data)), **fixed)
        for lies, problem in [([cut(1000), *[elsewhere] * 99], "the server failed"), ([wrong] * 9, "other bytes")]:
            server.fault(shard, *lies)
            with pytest.raises(StoreError, match=problem) as caught:
                store.read(window, "pose")
            assert S3["AWS_SECRET_ACCESS_KEY"] not in str(caught.value)

"""Servers that fail, lie or stop: each a message, nothing half in the cache, and nothing of a token anywhere."""

import errno
import json
import os
import shutil
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import json_sha256
from dancedata.files.addresses import local_folder, require_whole
from dancedata.kernel import DatasetFiles
from dancedata.remote import fetch
from dancedata.remote.pull import pull
from tests.messages import raises_message
from tests.remote.servers import Hub, Server, cut, other, status

SECRET = "hf_thisIsTheSecretToken"


@pytest.fixture
def address(server: Server) -> str:
    return f"{server.url}/store"


def _shard(published: Path) -> str:
    return next(p.name for p in sorted(published.iterdir()) if p.name.startswith("train-00000-of"))


def _whole(folder: Path, published: Path) -> bool:
    return all((folder / p.name).read_bytes() == p.read_bytes() for p in published.iterdir() if p.name != "README.md")


def _leftovers(folder: Path) -> list[str]:
    parts = folder.with_name(f"{folder.name}.parts")
    return sorted(p.name for p in parts.iterdir()) if parts.exists() else []


@pytest.mark.parametrize("code", [400, 401, 403, 404, 410])
def test_statuses_that_stay(server: Server, address: str, published: Path, code: int) -> None:
    server.fault(_shard(published), *[status(code)] * 3)
    with pytest.raises(StoreError, match=rf"{_shard(published)}: .*HTTP {code}"):
        pull(address, progress=False)
    assert server.requests[_shard(published)] == 1  # not asked for again
    server.faults.clear()
    assert _whole(pull(address, progress=False).path, published)


def _range_from_0(handler: Any, data: bytes) -> bool:
    handler.send_response(206)
    handler.send_header("Content-Range", f"bytes 0-{len(data) - 1}/{len(data)}")
    handler.send_header("Content-Length", str(len(data)))
    handler.end_headers()
    handler.wfile.write(data)
    return True


@pytest.mark.parametrize("ranges", [True, False])
@pytest.mark.parametrize(
    "faults",
    [
        *([status(code)] * 3 for code in (408, 429, 500, 502, 503)),
        [cut(1000), _range_from_0],  # not the range that was asked for
        [other(lambda data: data[:-10])],  # a short body
        [cut(1000), status(416)],  # the part is longer than the server's file
        [other(lambda data: bytes(len(data)))],  # wrong bytes, once
    ],
)
def test_faults_that_pass(server: Server, address: str, published: Path, faults: list[Any], ranges: bool) -> None:
    server.ranges = ranges
    server.fault(_shard(published), *faults)
    assert _whole(pull(address, progress=False).path, published)
    assert server.requests[_shard(published)] == len(faults) + 1 or not ranges


def test_statuses_that_do_not_pass_for_long(server: Server, address: str, published: Path) -> None:
    server.fault(_shard(published), *[status(503)] * 99)
    with pytest.raises(StoreError, match=r"the server failed 6 times; found HTTP 503; 0 bytes fetched. Run the same"):
        pull(address, progress=False)
    server.faults.clear()
    assert _whole(pull(address, progress=False).path, published)


def test_retry_after(server: Server, address: str, published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(fetch.time, "sleep", waits.append)
    date = "Wed, 21 Oct 2015 07:28:00 GMT"
    answers = [status(429, Retry_After="7"), status(503, Retry_After=date), status(503, Retry_After="99999")]
    server.fault(_shard(published), *answers, status(503, Retry_After="soon"))
    pull(address, progress=False)
    assert waits == [7.0, 0.0, 300.0, 0.0]  # WAIT_S is 0 here


def test_a_connection_that_is_cut_goes_on_from_there(server: Server, address: str, published: Path) -> None:
    name = _shard(published)
    size = (published / name).stat().st_size
    server.fault(name, *[cut(1000)] * 8)  # more often than ATTEMPTS: each brought something
    assert _whole(pull(address, progress=False).path, published)
    assert server.sent[name] == size
    ranges = [h.get("Range") for path, h in server.headers if path.endswith(name)]
    assert ranges[:3] == [None, "bytes=1000-", "bytes=2000-"]


@pytest.mark.parametrize("damage", [bytes, lambda data: b"x" * len(data)])
def test_goes_on_from_a_part(server: Server, address: str, published: Path, damage: Any) -> None:
    """Of a process that was killed; of another file its bytes are wrong, and the whole is asked for once more."""
    folder, name = pull(address, progress=False).path, _shard(published)
    data = (folder / name).read_bytes()
    (folder / name).unlink()
    folder.with_name(f"{folder.name}.parts").joinpath(f"{name}.part").write_bytes(damage(data[:1000]))
    server.sent.clear()
    pull(address, progress=False)
    assert (folder / name).read_bytes() == data
    assert server.sent[name] == len(data) - 1000 + (damage is not bytes) * len(data)


def test_wrong_bytes_twice(server: Server, address: str, published: Path) -> None:
    server.fault(_shard(published), *[other(lambda data: bytes(len(data)))] * 2)
    with pytest.raises(StoreError, match=r"other bytes than those of the dataset, twice; found sha256 [0-9a-f]{12}"):
        pull(address, progress=False)
    folder = local_folder(address)
    assert not (folder / _shard(published)).exists()
    assert f"{_shard(published)}.part" not in _leftovers(folder)
    assert _whole(pull(address, progress=False).path, published)


def test_more_bytes_than_the_file_has(server: Server, address: str, published: Path) -> None:
    server.fault(_shard(published), other(lambda data: data * 50))
    with pytest.raises(StoreError, match="the server sends more bytes than the file has"):
        pull(address, progress=False)
    assert f"{_shard(published)}.part" not in _leftovers(local_folder(address))


def test_a_description_that_is_too_large(server: Server, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DatasetFiles, "MAX_BYTES", 100)
    with raises_message(StoreError, "larger", where="dataset.json"):
        local_folder(address)


def test_no_server(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"the server failed 6 times; found Connection refused"):
        local_folder("http://127.0.0.1:9/store")


@pytest.mark.parametrize(
    ("name", "size"),
    [("../evil.h5", 1), ("/etc/evil", 1), ("a/b.h5", 1), (".hidden", 1), ("x\x00.h5", 1), ("x" * 300, 1),
     ("a.h5", -1), ("a.h5", True), ("dataset.json\n", 1), ("dataset.json", 1), ("Publication.JSON", 1)],
)  # fmt: skip
def test_names_that_lead_out(server: Server, address: str, own_cache: Path, name: str, size: int) -> None:
    def bend(data: bytes) -> bytes:
        document = json.loads(data)
        document["files"][name] = {"size": size, "sha256": "0" * 64}
        document["self_sha256"] = json_sha256({k: v for k, v in document.items() if k != "self_sha256"})
        return json.dumps(document).encode()

    server.fault("dataset.json", other(bend))
    with pytest.raises(StoreError, match=r"a file is listed that no dataset has; nothing was fetched"):
        local_folder(address)
    assert not own_cache.exists()


def test_names_of_a_description_that_was_changed_in_the_cache(address: str, published: Path, tmp_path: Path) -> None:
    folder = pull(address, progress=False).path
    (tmp_path / "kept").mkdir()
    document = json.loads((folder / "dataset.json").read_bytes())
    document["files"][str(tmp_path / "kept/stats.json")] = document["files"]["stats.json"]
    (folder / "dataset.json").write_text(json.dumps(document))
    with pytest.raises(StoreError, match="nothing was fetched"):
        require_whole(folder)
    assert not list((tmp_path / "kept").iterdir())


def test_a_description_that_was_damaged_in_the_cache_is_fetched_again(address: str, published: Path) -> None:
    path = local_folder(address) / "dataset.json"
    path.write_bytes(path.read_bytes()[::-1])
    assert len(dancedata.open(address)) == len(dancedata.open(published))


def test_replaced_while_it_is_read(server: Server, address: str, published: Path, tmp_path: Path) -> None:
    server.folder = shutil.copytree(published.parent, tmp_path / "upstream")
    store = dancedata.open(address)
    assert len(store)
    for shard in (server.folder / "store").glob("*-of-*.h5"):
        shard.write_bytes(shard.read_bytes()[::-1])
    with raises_message(StoreError, "may have been replaced or damaged there"):
        store.read(store.windows("train")[0], "pose")


def test_a_full_disk(server: Server, address: str, published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = local_folder(address)
    with monkeypatch.context() as patched:
        usage = shutil.disk_usage(folder)
        patched.setattr(shutil, "disk_usage", lambda path: usage._replace(free=100))
        with pytest.raises(
            StoreError, match=r"there is no space for the file; found No space left .*; 100 B are free"
        ):
            pull(address, progress=False)
    with monkeypatch.context() as patched:

        def full(fd: int) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        patched.setattr(fetch.os, "fsync", full)
        with pytest.raises(StoreError, match="there is no space for the file"):
            pull(address, progress=False)
    assert _whole(pull(address, progress=False).path, published)


_PULL = "import sys; from dancedata.remote.pull import pull; print(pull(sys.argv[1], progress=False).path)"


def _start(address: str) -> "subprocess.Popen[str]":
    return subprocess.Popen([sys.executable, "-c", _PULL, address], stdout=subprocess.PIPE, text=True)


def test_two_processes_fetch_once(server: Server, address: str, published: Path) -> None:
    processes = [_start(address) for _ in range(3)]
    folders = {p.communicate(timeout=60)[0].strip() for p in processes}
    assert len(folders) == 1
    assert _whole(Path(folders.pop()), published)
    assert max(n for name, n in server.requests.items() if name != "dataset.json") == 1


def test_the_hub_by_status(hub: Hub) -> None:
    with pytest.raises(StoreError, match=rf"no such repository, .*{hub.url}/datasets/org/other; if"):
        local_folder("hf://datasets/org/other")
    with pytest.raises(StoreError, match=r"has no such revision; found nosuchbranch\. Branches, tags and"):
        local_folder("hf://datasets/org/name@nosuchbranch")
    with pytest.raises(StoreError, match=r"a{40}/nosuchfolder/dataset.json: the repository has no such"):
        local_folder("hf://datasets/org/name@main/nosuchfolder")


def test_a_gated_repository(hub: Hub) -> None:
    hub.gated = True
    with pytest.raises(
        StoreError, match=rf"Accept its terms at {hub.url}/datasets/org/name, then log in with: hf auth"
    ):
        local_folder("hf://datasets/org/name")


def test_a_token_that_expires(hub, published, monkeypatch, capfd, own_cache):
    """A private repository: the token goes to the hub, and nowhere else; once it is refused, what is there stays."""
    hub.token = SECRET
    monkeypatch.setenv("HF_TOKEN", SECRET)
    store = dancedata.open("hf://datasets/org/name")
    assert len(store)
    hub.token = "another"
    with pytest.raises(StoreError, match="the hub does not accept the token") as caught:
        store.read(store.windows("train")[0], "pose")
    texts = [str(caught.value), repr(caught.value), *capfd.readouterr()]
    assert not any(SECRET in text for text in texts)
    assert not any(SECRET.encode() in p.read_bytes() for p in own_cache.rglob("*") if p.is_file())
    monkeypatch.setenv("HF_TOKEN", "another")
    assert _whole(pull("hf://datasets/org/name", progress=False).path, published)


def test_the_token_stays_with_the_hub(hub, server, published, monkeypatch):
    hub.token = SECRET
    monkeypatch.setenv("HF_TOKEN", SECRET)
    name = _shard(published)
    # As large files of the hub, with an address that expires.
    hub.fault(name, *[status(302, Location=f"{server.url}/store/{name}")] * 2)
    server.fault(name, status(403))
    assert _whole(pull("hf://datasets/org/name", progress=False).path, published)
    assert server.requests[name] == 2
    assert all("Authorization" not in headers for _, headers in server.headers)


@pytest.mark.parametrize(
    "endpoint", ["http://me:s3cr3t@127.0.0.1", "https://localhost/?t=s3cr3t", "localhost:s3cr3t"]
)
def test_an_address_of_a_hub_that_is_none_is_not_repeated(monkeypatch: pytest.MonkeyPatch, endpoint: str) -> None:
    monkeypatch.setenv("HF_ENDPOINT", endpoint)
    with pytest.raises(UsageError, match="HF_ENDPOINT is not the address of a hub") as caught:
        dancedata.open("hf://datasets/org/name")
    assert "s3cr3t" not in "".join(traceback.format_exception(caught.value))

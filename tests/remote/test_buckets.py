"""s3:// against moto, with obstore."""

import base64
import hmac
import json
import os
import shutil
import signal
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from email.utils import formatdate
from pathlib import Path

import pytest
import torch
from torch.utils.data import DataLoader

import dancedata
from dancedata.core.errors import StoreError
from dancedata.remote.address import parse_address
from dancedata.remote.client import Client
from dancedata.remote.pull import pull
from dancedata.torch import WindowDataset
from tests.messages import raises_message
from tests.remote.servers import Server, moto_bucket

obstore = pytest.importorskip("obstore")
pytest.importorskip("moto.server")


@pytest.fixture(scope="module")
def environment(published: Path) -> Iterator[dict[str, str]]:
    with moto_bucket(published, "some/set") as environment:
        yield environment


@pytest.fixture
def bucket(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the address of the dataset, with its credentials in the environment."""
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    return "s3://dances/some/set"


def test_a_bucket(bucket: str, published: Path) -> None:
    _same_rows(bucket, published)


def test_goes_on_from_a_part(bucket: str, published: Path) -> None:
    pulled = pull(bucket, "val", progress=False)
    shard = next(p for p in pulled.path.iterdir() if p.name.startswith("val-00000-of"))
    part = pulled.path.with_name(f"{pulled.path.name}.parts") / f"{shard.name}.part"
    data = shard.read_bytes()
    shard.unlink()
    part.write_bytes(data[:1000])
    pull(bucket, "val", progress=False)
    assert shard.read_bytes() == data
    shard.unlink()
    part.write_bytes(b"x" * 1000)  # of another file: wrong bytes, once more
    pull(bucket, "val", progress=False)
    assert shard.read_bytes() == data


def test_forked_workers(bucket: str, published: Path) -> None:
    """obstore is used in this process before, and would hang in a forked child."""
    remote, local = (WindowDataset(where, "val", scale=None) for where in (bucket, published))
    loader = DataLoader(remote, batch_size=16, num_workers=1, multiprocessing_context="fork", timeout=60)
    for a, b in zip(loader, DataLoader(local, batch_size=16), strict=True):
        assert torch.equal(a["pose"], b["pose"])


def test_forked_workers_execute_nothing_of_the_working_folder(bucket, published, tmp_path, monkeypatch):
    """The processes that fetch for them are started there, where modules may have the names of Python's own."""
    for name in ("json", "ssl", "dancedata"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'executed')!r}, 'w')\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    remote = WindowDataset(dancedata.open(bucket), "val", scale=None)
    loader = DataLoader(remote, batch_size=16, num_workers=1, multiprocessing_context="fork", timeout=60)
    assert len(list(loader)) == len(list(DataLoader(WindowDataset(published, "val"), batch_size=16)))
    assert not (tmp_path / "executed").exists()


def test_a_source_that_crossed_a_fork_is_an_error_at_once(bucket: str) -> None:
    source = Client(parse_address(bucket))
    child = os.fork()
    if child == 0:
        signal.alarm(20)  # a hang fails
        try:
            source.open("dataset.json", 0)
        except StoreError as error:
            os._exit(0 if "would hang" in str(error) else 2)
        os._exit(1)
    assert os.waitpid(child, 0)[1] == 0


def test_a_client_that_crossed_a_fork(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.remote.client._first_used_in", 1)
    with raises_message(StoreError, "obstore", where="s3://dances/some/set"):
        dancedata.open(bucket)


def test_what_is_not_there(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StoreError, match=r"s3://dances/other/dataset.json: there is no such file"):
        dancedata.open("s3://dances/other")
    with pytest.raises(StoreError) as caught:
        dancedata.open("s3://nosuchbucket/other")
    assert "s3cr3t" not in str(caught.value)


def test_a_server_that_is_gone(monkeypatch: pytest.MonkeyPatch, bucket: str) -> None:
    monkeypatch.setenv("AWS_ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(StoreError, match="the server failed 6 times") as caught:
        dancedata.open(bucket)
    assert "s3cr3t" not in str(caught.value)


def _same_rows(address: str, published: Path) -> None:
    local = WindowDataset(published, "val", scale=None)
    remote = WindowDataset(address, "val", scale=None)
    assert all(torch.equal(a["pose"], b["pose"]) for a, b in zip(remote, local, strict=True))
    folder = pull(address, progress=False).path
    assert all((folder / p.name).read_bytes() == p.read_bytes() for p in published.iterdir() if p.name != "README.md")


def test_google(server: Server, published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """gs:// of a server that gives BUCKET/OBJECT, as Google's does to reads; its logins are not tried."""
    key = {"gcs_base_url": server.url, "disable_oauth": True, "client_email": "", "private_key": ""}
    monkeypatch.setenv("GOOGLE_SERVICE_ACCOUNT_KEY", json.dumps({**key, "private_key_id": ""}))
    _same_rows("gs://store/", published)
    with pytest.raises(StoreError, match=r"gs://other/dataset\.json: there is no such file"):
        dancedata.open("gs://other")


@pytest.mark.nightly
@pytest.mark.skipif(shutil.which("azurite-blob") is None, reason="needs azurite: npm install -g azurite")
def test_azure(published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """az:// of Microsoft's emulator, whose account and key are those of its documentation; it checks signatures."""
    command = ["azurite-blob", "--silent", "--location", str(tmp_path), "--skipApiVersionCheck"]
    process = subprocess.Popen(command)
    try:
        monkeypatch.setenv("AZURE_STORAGE_USE_EMULATOR", "true")
        for _ in range(100):
            with suppress(OSError), socket.create_connection(("127.0.0.1", 10000), 1):
                break
            time.sleep(0.2)
        _make_container("dances")
        store = obstore.store.from_url("az://dances/some")
        for path in published.iterdir():
            obstore.put(store, path.name, path.read_bytes())
        _same_rows("az://dances/some", published)
        with pytest.raises(StoreError, match="there is no such file"):
            dancedata.open("az://dances/other")
    finally:
        process.kill()
        process.wait()


def _make_container(name: str) -> None:
    """Make a container of the emulator, which obstore cannot: Put Container of Azure's REST interface, signed."""
    account, key = (
        "devstoreaccount1",
        "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw==",
    )
    date = formatdate(usegmt=True)
    headers = {"x-ms-date": date, "x-ms-version": "2021-08-06"}
    text = f"PUT\n\n\n\n\n\n\n\n\n\n\n\nx-ms-date:{date}\nx-ms-version:2021-08-06\n"
    text += f"/{account}/{account}/{name}\nrestype:container"
    signature = base64.b64encode(hmac.digest(base64.b64decode(key), text.encode(), "sha256")).decode()
    headers["Authorization"] = f"SharedKey {account}:{signature}"
    url = f"http://127.0.0.1:10000/{account}/{name}?restype=container"
    urllib.request.urlopen(urllib.request.Request(url, headers=headers, method="PUT"), timeout=60).close()

"""s3:// against moto, with obstore."""

import json
import os
import signal
from collections.abc import Iterator
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

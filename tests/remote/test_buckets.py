"""s3:// against moto, with obstore."""

import logging
import os
import signal
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import dancedata
from dancedata.core.errors import StoreError
from dancedata.readers import WindowDataset
from dancedata.remote import pull
from dancedata.remote.address import parse_address
from dancedata.remote.bucket import BucketSource
from tests.messages import raises_message

obstore = pytest.importorskip("obstore")
moto = pytest.importorskip("moto.server")


@pytest.fixture(scope="module")
def endpoint(published: Path) -> Iterator[str]:
    """Return the address of an S3 server with a bucket that has the dataset."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    bucket = f"http://{host}:{port}/dances"
    for path in (bucket, *(f"{bucket}/some/set/{p.name}" for p in published.iterdir())):
        data = b"" if path == bucket else (published / path.rsplit("/", 1)[-1]).read_bytes()
        headers = {"Content-Type": "binary/octet-stream"}
        urllib.request.urlopen(urllib.request.Request(path, data, headers, method="PUT"), timeout=9).close()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def bucket(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the address of the dataset, with its credentials in the environment."""
    for name, value in {
        "AWS_ENDPOINT": endpoint, "AWS_ALLOW_HTTP": "true", "AWS_ACCESS_KEY_ID": "key", "AWS_REGION": "us-east-1",
        "AWS_SECRET_ACCESS_KEY": "s3cr3tOfTheBucket",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    return "s3://dances/some/set"


def test_a_bucket(bucket: str, published: Path) -> None:
    with dancedata.open(bucket) as remote, dancedata.open(published) as local:
        window = local.windows("train")[-1]
        np.testing.assert_array_equal(remote.read(window, "pose"), local.read(window, "pose"))
    folder = pull(bucket, progress=False).path
    assert all((folder / p.name).read_bytes() == p.read_bytes() for p in published.iterdir() if p.name != "README.md")


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
    remote, local = (WindowDataset(where, "val", normalize=False) for where in (bucket, published))
    loader = DataLoader(remote, batch_size=16, num_workers=1, multiprocessing_context="fork", timeout=60)
    for a, b in zip(loader, DataLoader(local, batch_size=16), strict=True):
        assert torch.equal(a["pose"], b["pose"])


def test_ranges_of_a_bucket(bucket: str, published: Path) -> None:
    """Here, in forked workers, for which a process of its own asks, and in spawned ones."""
    store = dancedata.open(bucket, stream=True)
    remote, local = WindowDataset(store, "test", normalize=False), WindowDataset(published, "test", normalize=False)
    assert torch.equal(remote[0]["pose"], local[0]["pose"])
    for context in ("fork", "spawn"):
        loader = DataLoader(remote, batch_size=16, num_workers=1, multiprocessing_context=context, timeout=60)
        for a, b in zip(loader, DataLoader(local, batch_size=16), strict=True):
            assert torch.equal(a["pose"], b["pose"])
    assert not [p.name for p in store.path.iterdir() if p.name.startswith("test-0")]


def test_a_source_that_crossed_a_fork_is_an_error_at_once(bucket: str) -> None:
    source = BucketSource(parse_address(bucket))
    child = os.fork()
    if child == 0:
        signal.alarm(20)  # a hang fails
        try:
            source.open("dataset.json", 0, 10)
        except StoreError as error:
            os._exit(0 if "would hang" in str(error) else 2)
        os._exit(1)
    assert os.waitpid(child, 0)[1] == 0


def test_a_client_that_crossed_a_fork(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.remote.bucket._first_used_in", 1)
    with raises_message(StoreError):
        dancedata.open(bucket)


def test_what_is_not_there(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StoreError, match=r"s3://dances/other/dataset.json: there is no such object"):
        dancedata.open("s3://dances/other")
    with pytest.raises(StoreError) as caught:
        dancedata.open("s3://nosuchbucket/other")
    assert "s3cr3t" not in str(caught.value)


def test_a_server_that_is_gone(monkeypatch: pytest.MonkeyPatch, bucket: str) -> None:
    monkeypatch.setenv("AWS_ENDPOINT", "http://127.0.0.1:9")
    monkeypatch.setattr("dancedata.remote.bucket._RETRY", {"max_retries": 0})
    with pytest.raises(StoreError, match="the server failed 6 times") as caught:
        dancedata.open(bucket)
    assert "s3cr3t" not in str(caught.value)

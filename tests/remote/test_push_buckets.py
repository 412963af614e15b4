"""dancedata push to s3:// against moto, with obstore."""

import json
import logging
import shutil
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import json_sha256, sha256_bytes
from dancedata.remote import pull
from dancedata.remote.cached import remote_files
from dancedata.store import open_store
from tests.messages import raises_message

obstore = pytest.importorskip("obstore")
moto = pytest.importorskip("moto.server")
SECRET = "s3cr3tOfTheBucket"


class Killed(BaseException):
    """The process is gone."""


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    url = f"http://{host}:{port}"
    urllib.request.urlopen(urllib.request.Request(f"{url}/dances", b"", method="PUT"), timeout=9).close()
    yield url
    server.stop()


@pytest.fixture
def bucket(endpoint: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> str:
    """Return an address where nothing is."""
    for name, value in {
        "AWS_ENDPOINT": endpoint, "AWS_ALLOW_HTTP": "true", "AWS_ACCESS_KEY_ID": "key", "AWS_REGION": "us-east-1",
        "AWS_SECRET_ACCESS_KEY": SECRET,
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    return f"s3://dances/{request.node.name.split('[')[0]}"


def push(store: Path, to: str, **options: Any) -> Any:
    return dancedata.push(store, to, **{"rights": "random numbers", "progress": False} | options)


def there(address: str) -> dict[str, bytes]:
    from obstore.store import from_url

    store = from_url(address)
    names = [meta["path"] for page in obstore.list(store) for meta in page]
    return {name: bytes(obstore.get(store, name).bytes()) for name in names}


def local(store: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in store.iterdir() if p.name != "README.md"}


def test_a_dataset_in_a_bucket(bucket: str, published: Path) -> None:
    pushed = push(published, bucket)
    files = there(bucket)
    assert {k: v for k, v in files.items() if k in local(published)} == local(published)
    assert f"dancedata.open('{bucket}')" in files["README.md"].decode()
    assert (pushed.address, pushed.commit, pushed.files) == (bucket, "", len(files))
    with dancedata.open(bucket) as remote, open_store(published) as ours:
        assert remote.meta["self_sha256"] == ours.meta["self_sha256"]
    assert push(published, bucket).uploaded_bytes == 0


def test_another_dataset_is_replaced_on_request_alone(
    bucket: str, published: Path, random_store: Callable[..., Any], tmp_path: Path
) -> None:
    push(published, bucket)
    other = random_store(tmp_path / "other", seed=3).path
    with raises_message(UsageError, "prefix"):
        push(other, bucket)
    assert there(bucket)["dataset.json"] == local(published)["dataset.json"]
    push(other, bucket, overwrite=True)
    assert there(bucket).keys() == local(other).keys() | {"README.md", "publication.json"}
    push(other, bucket, recipe_only=True, rights=None, overwrite=True)
    assert not [name for name in there(bucket) if name.endswith(".h5") or name == "dataset.json"]
    push(published, bucket, overwrite=True)
    pull(bucket, progress=False)


def test_files_of_others_are_kept(bucket: str, published: Path) -> None:
    from obstore.store import from_url

    obstore.put(from_url(bucket), "README.md", b"mine")
    obstore.put(from_url(bucket), "notes.txt", b"mine too")
    with raises_message(UsageError, "publish", where="test_files_of_others_are_kept"):
        push(published, bucket)
    assert there(bucket) == {"README.md": b"mine", "notes.txt": b"mine too"}
    push(published, bucket, overwrite=True)
    assert there(bucket)["notes.txt"] == b"mine too"


def test_a_publication_that_lists_files_of_others(
    bucket: str, published: Path, random_store: Callable[..., Any], tmp_path: Path
) -> None:
    from obstore.store import from_url

    def lists(name: str) -> None:
        document = {"files": {name: {"size": 4, "sha256": "0" * 64}}, "shards": []}
        data = json.dumps(document | {"self_sha256": json_sha256(document)}).encode()
        obstore.put(from_url(bucket), "publication.json", data)

    push(random_store(tmp_path / "other", seed=3).path, bucket)
    obstore.put(from_url(bucket), "notes.txt", b"mine")
    lists("../elsewhere.txt")
    with pytest.raises(StoreError, match="a file is listed that no dataset has"):
        push(published, bucket, overwrite=True)
    lists("notes.txt")
    push(published, bucket, overwrite=True)
    assert there(bucket)["notes.txt"] == b"mine"


@pytest.mark.parametrize("replaced", [False, True])
def test_killed_before_any_request(
    bucket: str, published: Path, random_store: Callable[..., Any], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, replaced: bool,
) -> None:  # fmt: skip
    """Before the k-th object is written or removed: what is there opens as one of the two, or not at all."""
    first = random_store(tmp_path / "first", seed=4, clips={"train": 2}).path
    second = random_store(tmp_path / "second", seed=5, clips={"train": 2, "val": 1}).path
    whole = {local(path)["dataset.json"] for path in (first, second)}
    real = {name: getattr(obstore, name) for name in ("put", "delete")}
    calls = 0
    k = 0
    while True:
        bucket_k = f"{bucket}/{replaced}/{k}"
        if replaced:
            push(first, bucket_k)
        calls = 0

        def killed(name: str, *args: Any, k: int = k, **options: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls > k:
                raise Killed
            return real[name](*args, **options)

        with monkeypatch.context() as patched:
            for name in real:
                patched.setattr(obstore, name, lambda *args, name=name, **options: killed(name, *args, **options))
            try:
                push(second, bucket_k, overwrite=replaced)
                finished = True
            except Killed:
                finished = False
        found = there(bucket_k)
        if "dataset.json" in found:
            assert found["dataset.json"] in whole
            listed = remote_files(json.loads(found["dataset.json"]))
            assert all(sha256_bytes(found[file.name]) == file.sha256 for file in listed)
        else:
            with pytest.raises(StoreError):
                dancedata.open(bucket_k)
        push(second, bucket_k, overwrite=replaced)
        assert there(bucket_k).keys() == local(second).keys() | {"README.md", "publication.json"}
        if finished:
            break
        k += 1
    assert k >= len(local(second))


def test_keys_are_in_no_error(bucket: str, published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StoreError) as caught:
        push(published, "s3://nosuchbucket/x")
    monkeypatch.setenv("AWS_ENDPOINT", f"http://user:{SECRET}@127.0.0.1:9")
    monkeypatch.setattr("dancedata.remote.bucket._RETRY", {"max_retries": 0})
    with pytest.raises(StoreError, match="no half of a publication") as gone:
        push(published, bucket)
    for error in (caught.value, gone.value):
        assert SECRET not in str(error)
        assert error.__suppress_context__


@pytest.mark.parametrize("size", [0, 6_000_000], ids=["in parts", "whole"])
def test_a_dataset_that_is_replaced_during_the_upload(
    bucket: str, published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    """Files of the same names and sizes with other bytes: what was read of the first one describes no mixture."""
    from dancedata.publish.bucket import BucketUpload

    bucket, store = f"{bucket}/{size}", tmp_path / "store"
    shutil.copytree(published, store)
    monkeypatch.setattr("dancedata.publish.bucket._PART", size)
    real = BucketUpload._put

    def put(self: BucketUpload, *arguments: Any) -> None:
        for path in store.glob("train-*.h5"):
            path.write_bytes(path.read_bytes()[::-1])
        real(self, *arguments)

    with monkeypatch.context() as patched:
        patched.setattr(BucketUpload, "_put", put)
        with pytest.raises(StoreError, match="the dataset was changed while it was published"):
            push(store, bucket)
    assert not {"dataset.json", "train-00000-of-00008.h5"} & there(bucket).keys()
    shutil.rmtree(store)
    shutil.copytree(published, store)
    push(store, bucket)
    pull(bucket, progress=False)

"""dancedata cache and cache prune on datasets that were fetched, and dancedata pull."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import dancedata
from dancedata.cli.app import app
from dancedata.execution.cache_admin import prune
from dancedata.pages.write import write_report
from dancedata.remote.pull import pull
from dancedata.torch import GroupDataset
from tests.groups_store import write_groups
from tests.remote.servers import Server, cut


def _run(*args: object, code: int = 0) -> Any:
    result = CliRunner().invoke(app, [*map(str, args), "--json"])
    assert result.exit_code == code, result.output
    return json.loads(result.stdout)["result"]


def test_info_counts_them(server: Server, own_cache: Path) -> None:
    pulled = _run("pull", f"{server.url}/store", "--split", "val")
    stage = _run("cache")["stages"]["datasets"]
    assert stage["entries"] == pulled["files"] == pulled["fetched_files"]
    assert _run("cache", "verify")["damaged"] == []


def test_prune_by_size_and_what_is_fetched_again(server: Server, own_cache: Path) -> None:
    pulled = pull(f"{server.url}/store", progress=False)
    store = dancedata.open(pulled.path)
    window = store.windows("train")[0]
    before = store.read(window, "pose")
    result = prune(own_cache, max_bytes=0)
    assert result.removed >= pulled.files - 2
    assert result.in_use >= 1  # the shard that is open
    np.testing.assert_array_equal(store.read(window, "pose"), before)
    last = store.windows("train")[-1]
    server.requests.clear()
    assert store.read(last, "pose").shape == before.shape
    assert sum(n for name, n in server.requests.items() if name.startswith("train-0")) >= 1


def test_prune_by_age_is_by_the_last_opening(server: Server, own_cache: Path) -> None:
    pulled = pull(f"{server.url}/store", progress=False)
    for path in (*pulled.path.iterdir(), pulled.path.with_name(f"{pulled.path.name}.json")):
        os.utime(path, (1e9, 1e9))
    assert prune(own_cache, older_than_s=3600, dry=True).removed == pulled.files
    dancedata.open(f"{server.url}/store")
    assert prune(own_cache, older_than_s=3600).removed == 0


def test_parts_are_pruned_too(server: Server, own_cache: Path, published: Path) -> None:
    name = next(p.name for p in published.iterdir() if p.name.startswith("train-00000-of"))
    server.fault(name, cut(500), *[lambda handler, data: (handler.status(400), True)[1]] * 2)
    with pytest.raises(dancedata.core.errors.StoreError):
        pull(f"{server.url}/store", progress=False)
    assert [p.name for p in own_cache.rglob("*.part")] == [f"{name}.part"]
    prune(own_cache, max_bytes=0)
    assert not list(own_cache.rglob("*.part"))


def test_exports_and_evaluations_name_the_commit(hub, built, tmp_path, monkeypatch):
    hub.commits = {"a" * 40: built}
    address = f"hf://datasets/org/name@{'a' * 40}"
    exported = dancedata.export("hf://datasets/org/name", "npz", tmp_path / "npz", progress=False)
    assert exported.about["address"] == address
    report = dancedata.evaluate("hf://datasets/org/name", metrics=("pfc",), intervals=False, jobs=1, progress=False)
    assert address in str(report.to_json())
    written = write_report("hf://datasets/org/name", None, clips=0, progress=False)
    assert written.to_json() == write_report(built, None, clips=0, progress=False).to_json()


def test_groups_and_the_viewer(server: Server, tmp_path: Path) -> None:
    server.folder = tmp_path
    write_groups(tmp_path / "groups", 60)
    address = f"{server.url}/groups"
    remote, local = (GroupDataset(where, "train", scale=None) for where in (address, tmp_path / "groups"))
    assert len(remote) == len(local) > 0
    assert np.array_equal(remote[0]["person_mask"], local[0]["person_mask"])
    result = CliRunner().invoke(app, ["view", address, "--out", str(tmp_path / "page.html"), "--quiet"])
    assert result.exit_code == 0, result.output

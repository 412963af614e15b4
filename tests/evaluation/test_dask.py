"""Evaluation on a Dask cluster gives what it gives here."""

from pathlib import Path

import pytest

import dancedata
from dancedata.store import Store


def test_a_cluster_gives_the_same_numbers(store: Store, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    here = dancedata.evaluate(store, bootstrap=0, cache=tmp_path / "here")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None
    ) as cluster:
        there = dancedata.evaluate(
            store, bootstrap=0, cache=tmp_path / "there", backend="dask", scheduler=cluster.scheduler_address
        )
    assert there.to_json() == here.to_json()
    assert there.per_clip == here.per_clip
    assert list((tmp_path / "there").rglob("*"))

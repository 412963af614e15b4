"""Evaluation on a Dask cluster gives what it gives here."""

import os
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.store import Store
from dancedata.synthetic import write_synthetic
from tests.clusters import dask_cluster


def test_a_cluster_gives_the_same_numbers(store: Store, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    here = dancedata.evaluate(store, intervals=False, cache=tmp_path / "here")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None
    ) as cluster:
        there = dancedata.evaluate(
            store, intervals=False, cache=tmp_path / "there", backend="dask", scheduler=cluster.scheduler_address
        )
    assert there.to_json() == here.to_json()
    assert there.per_clip == here.per_clip
    assert list((tmp_path / "there").rglob("*"))


def test_workers_in_another_folder_read_the_same_music(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative paths name the files of the caller, and not others of the same names beside the worker."""
    pytest.importorskip("distributed")
    for seed, name in enumerate(("here", "there")):
        write_synthetic(tmp_path / name, seed=seed, songs=2, clips_per_song=2, clip_s=6.0)
    options: dict[str, Any] = {"fps": 60, "up": "y", "unit": "m", "metrics": ("bas",), "intervals": False}
    options["music"] = "."
    monkeypatch.chdir(tmp_path / "there")
    with dask_cluster(os.environ, workers=1) as address:
        monkeypatch.chdir(tmp_path / "here")
        there = dancedata.evaluate("motions", cache=tmp_path / "a", scheduler=address, **options)
    assert there.to_json() == dancedata.evaluate("motions", cache=tmp_path / "b", **options).to_json()

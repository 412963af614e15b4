"""Evaluation on a Dask cluster gives what it gives here."""

import os
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.synthetic import write_synthetic
from tests.clusters import dask_cluster


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
    here = dancedata.evaluate("motions", cache=tmp_path / "b", **options)
    assert there.to_json() == here.to_json()
    assert there.per_clip == here.per_clip
    assert list((tmp_path / "a").rglob("*"))

"""The evaluator of training loops: batches give what the same samples give as files, on one process or several."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.metrics import Evaluator
from dancedata.store import Store

LENGTH = 150


@pytest.fixture(scope="module")
def batch(store: Store) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Windows of train: ids, normalised columns (B, L, D), and rows of music (B, L, 35)."""
    windows = list(store.windows("train"))[::3]
    scaler = store.normalizer("edge151")
    columns = np.stack([scaler.normalize(store.read(w, "edge151")) for w in windows])
    music = np.stack([store.read(w, "librosa35") for w in windows])
    return [f"{w.clip}@{w.start}" for w in windows], columns, music


@pytest.fixture(scope="module")
def evaluator(store: Store) -> Evaluator:
    return Evaluator.of(store, "edge151", split="train")


def values(report: Any) -> dict[str, float | None]:
    return {score.name: score.value for score in report.scores}


def test_batches_give_what_the_motions_give(store: Store, evaluator: Evaluator, batch: Any) -> None:
    ids, columns, music = batch
    evaluator.reset()
    for k in range(0, len(ids), 4):
        evaluator.update(columns[k : k + 4], ids=ids[k : k + 4], music=music[k : k + 4])
    assert len(evaluator) == len(ids)
    found = evaluator.compute()
    scaler = store.normalizer("edge151")
    motions: Mapping[str, Motion] = {
        name: dancedata.decode(scaler.unnormalize(rows.astype(np.float64), clip=True), "edge151", fps=30)
        for name, rows in zip(ids, columns, strict=True)
    }
    beats = {
        name: dancedata.metrics.MusicBeats.of(np.flatnonzero(rows[:, 34]), store.grid)
        for name, rows in zip(ids, music, strict=True)
    }
    whole = dancedata.evaluate(motions, pool=store, pool_split="train", beats=beats, bootstrap=0)
    for name, value in values(whole).items():
        assert value is not None
        assert values(found)[name] == pytest.approx(value, rel=1e-9), name
    assert found.role == "generated"


def test_torch_on_any_dtype(evaluator: Evaluator, batch: Any) -> None:
    torch = pytest.importorskip("torch")
    ids, columns, music = batch
    evaluator.reset()
    evaluator.update(columns, ids=ids, music=music)
    of_numpy = evaluator.compute()
    evaluator.reset()
    evaluator.update(torch.from_numpy(columns).requires_grad_(), ids=ids, music=torch.from_numpy(music)[..., 34])
    assert values(evaluator.compute()) == values(of_numpy)
    evaluator.reset()
    evaluator.update(torch.from_numpy(columns).to(torch.bfloat16), ids=ids)
    report = evaluator.compute()
    assert report["fid_g"] is not None
    assert next(s for s in report.scores if s.name == "pfc").n == len(ids)


def test_processes_are_joined_without_repeated_samples(store: Store, evaluator: Evaluator, batch: Any) -> None:
    ids, columns, music = batch
    evaluator.reset()
    evaluator.update(columns, ids=ids, music=music)
    alone = evaluator.compute()
    ranks = [
        Evaluator(evaluator.protocol, evaluator.reader, evaluator.pool, beat_column=34, music_grid=store.grid)
        for _ in range(2)
    ]
    for rank, own in enumerate(ranks):
        mine = [*range(rank, len(ids), 2), 0]  # both have sample 0, as samplers fill up
        own.update(columns[mine], ids=[ids[k] for k in mine], music=music[mine])
    parts: list[Any] = []
    for own in ranks:
        own.gather(lambda objects: parts.extend(objects) or objects)
    for own in ranks:
        own.gather(lambda objects: list(parts))
        assert len(own) == len(ids)
        assert values(own.compute()) == values(alone)


def test_a_single_process_gathers_its_own(evaluator: Evaluator, batch: Any) -> None:
    _, columns, _ = batch
    evaluator.reset()
    evaluator.update(columns[:3])
    assert len(evaluator.gather()) == 3
    evaluator.update(columns[3:5])
    assert len(evaluator) == 5


def test_samples_that_cannot_be_measured_are_named(evaluator: Evaluator, batch: Any) -> None:
    _, columns, music = batch
    broken = columns[:3].copy()
    broken[1, 5] = np.nan
    evaluator.reset()
    evaluator.update(broken, ids=["a", "b", "c"])
    report = evaluator.compute()
    assert report.clips == ("a", "c")
    assert report.left_out[0][0] == "b"
    evaluator.reset()
    with pytest.raises(UsageError, match="no sample could be measured; found no batch was given"):
        evaluator.compute()
    with pytest.raises(UsageError, match="a batch of motion has three axes"):
        evaluator.update(columns[0])
    with pytest.raises(UsageError, match="music and motion differ in length; found 2 and 3"):
        evaluator.update(columns[:3], music=music[:2])


def test_columns_that_do_not_fit_the_protocol(store: Store) -> None:
    with pytest.raises(UsageError, match="not on SMPL-X"):
        Evaluator.of(store, "edge151", protocol="lodge-finedance")
    assert "Evaluator('dancedata', 0 samples)" in repr(Evaluator.of(store, "edge151"))


def _of_rank(rank: int, world: int, path: str, file: str, results: Any) -> None:
    import torch

    torch.distributed.init_process_group("gloo", init_method=f"file://{file}", rank=rank, world_size=world)
    dataset = dancedata.open(path)
    evaluator = Evaluator.of(dataset, "edge151", split="train")
    scaler = dataset.normalizer("edge151")
    windows = list(dataset.windows("train"))[rank::world]
    evaluator.update(np.stack([scaler.normalize(dataset.read(w, "edge151")) for w in windows]))
    report = evaluator.gather().compute()
    results.put((rank, len(evaluator), values(report)))
    torch.distributed.destroy_process_group()


@pytest.mark.nightly
def test_torch_distributed(store: Store, tmp_path: Any) -> None:
    pytest.importorskip("torch")
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    arguments = (2, str(store.path), str(tmp_path / "rendezvous"), results)
    processes = [context.Process(target=_of_rank, args=(rank, *arguments)) for rank in range(2)]
    for process in processes:
        process.start()
    (_, n, one), (_, m, other) = (results.get(timeout=300) for _ in processes)
    assert n == m == len(list(store.windows("train")))
    assert one == other
    for process in processes:
        process.join()

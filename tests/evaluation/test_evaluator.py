"""The evaluator of training loops: batches give what the same samples give as files, on one process or several."""

from typing import Any

import numpy as np
import pytest

from dancedata import Evaluator
from dancedata.core.errors import DataError, UsageError
from dancedata.evaluation.protocol import Pieces
from dancedata.evaluation.protocols.dancedata import Dancedata
from dancedata.store import Store
from tests.messages import raises_message

LENGTH = 150


@pytest.fixture(scope="module")
def batch(store: Store) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Windows of train: ids, normalised columns (B, L, D), and rows of music (B, L, 35)."""
    windows = list(store.windows("train"))[::2]
    scaler = store.scaler("edge151")
    columns = np.stack([scaler.normalize(store.read(w, "edge151")) for w in windows])
    music = np.stack([store.read(w, "librosa35") for w in windows])
    return [f"{w.clip}@{w.start}+{w.length}" for w in windows], columns, music


@pytest.fixture(scope="module")
def evaluator(store: Store) -> Evaluator:
    return Evaluator(store, "edge151", split="train", normalized=True)


def values(report: Any) -> dict[str, float | None]:
    return {score.name: score.value for score in report.scores}


def gathered(*ranks: Evaluator, **options: Any) -> None:
    """Gather evaluators as the processes of one job do."""
    parts: list[Any] = []
    for own in ranks:
        own.gather(lambda objects: parts.extend(objects) or objects)
    for own in ranks:
        own.gather(lambda objects: list(parts), **options)


def two(store: Store) -> tuple[Evaluator, Evaluator]:
    first, second = [Evaluator(store, "edge151", split="train", normalized=True) for _ in range(2)]
    return first, second


def test_samples_are_cut_as_generated_dances(store: Store, batch: Any) -> None:
    class Halves(Dancedata):
        generated = Pieces(first=LENGTH // 2)

    evaluator = Evaluator(store, "edge151", protocol=Halves(), split="train", normalized=True)
    evaluator.update(batch[1], ids=batch[0])
    assert evaluator.compute(intervals=False).seconds == (2.5, 2.5, 2.5)


def test_torch_on_any_dtype(evaluator: Evaluator, batch: Any) -> None:
    torch = pytest.importorskip("torch")
    ids, columns, music = batch
    evaluator.reset()
    evaluator.update(columns, ids=ids, music=music)
    of_numpy = evaluator.compute()
    evaluator.reset()
    evaluator.update(torch.from_numpy(columns).requires_grad_(), ids=ids, music=torch.from_numpy(music))
    assert values(evaluator.compute()) == values(of_numpy)
    evaluator.reset()
    evaluator.update(columns, ids=ids, music=torch.from_numpy(music)[..., 34])  # beats between rows are not known
    assert evaluator.compute()["bas"].value == pytest.approx(of_numpy["bas"].value, abs=0.03)
    evaluator.reset()
    evaluator.update(torch.from_numpy(columns).to(torch.bfloat16), ids=ids)
    report = evaluator.compute()
    assert report["fid_g"].value is not None
    assert next(s for s in report.scores if s.name == "pfc").n == len(ids)


def test_processes_are_joined_without_repeated_samples(store: Store, evaluator: Evaluator, batch: Any) -> None:
    ids, columns, music = batch
    evaluator.reset()
    evaluator.update(columns, ids=ids, music=music)
    alone = evaluator.compute()
    ranks = two(store)
    for rank, own in enumerate(ranks):
        mine = [*range(rank, len(ids), 2), 0]  # both have sample 0, as samplers fill up
        own.update(columns[mine], ids=[ids[k] for k in mine], music=music[mine])
    gathered(*ranks)
    for own in ranks:
        assert len(own) == len(ids)
        assert values(own.compute()) == values(alone)


def test_samples_that_cannot_be_measured_are_named(evaluator: Evaluator, batch: Any) -> None:
    ids, columns, music = batch
    broken = columns[:3].copy()
    broken[1, 5] = np.nan
    evaluator.reset()
    evaluator.update(broken, ids[:3])
    report = evaluator.compute()
    assert set(report.clips) == {ids[0], ids[2]}
    assert report.left_out[0][0] == ids[1]
    evaluator.reset()
    with raises_message(UsageError, "could"):
        evaluator.compute()
    with raises_message(UsageError, "three"):
        evaluator.update(columns[0], ids[:1])
    with raises_message(UsageError, "batch"):
        evaluator.update(columns[:3, :, :139], ids[:3])
    with raises_message(UsageError, "audio"):
        evaluator.update(columns[:3], ids[:3], music=music[:3, :, :20])
    with raises_message(UsageError, "differ"):
        evaluator.update(columns[:3], ids[:3], music=music[:2])
    with raises_message(UsageError, "ids"):
        evaluator.update(columns[:3], ids[:2])
    for wrong, reason in (("nobody@0+150", "no_clip"), (ids[0].split("@")[0] + "@100+900", "outside")):
        with raises_message(DataError, "clip", reason=reason, where=wrong):
            evaluator.update(columns[:1], [wrong])
    evaluator.update(columns[:1], [ids[0].replace("+150", "+149")])
    with raises_message(UsageError, "id states"):
        evaluator.compute()


def test_padding_is_not_measured(store: Store, evaluator: Evaluator, batch: Any) -> None:
    ids, columns, music = batch
    sizes = [LENGTH, 131, 97, 140]
    ids = [name.replace("+150", f"+{n}") for name, n in zip(ids, sizes, strict=False)]
    evaluator.reset()
    for k, n in enumerate(sizes):
        evaluator.update(columns[k : k + 1, :n], ids=ids[k : k + 1], music=music[k : k + 1, :n])
    alone = values(evaluator.compute())
    padded, heard = np.zeros((4, LENGTH + 10, 151)), np.zeros((4, LENGTH + 10, 35))
    for k, n in enumerate(sizes):
        padded[k, :n], heard[k, :n] = columns[k, :n], music[k, :n]
    evaluator.reset()
    evaluator.update(padded, ids=ids[:4], music=heard, lengths=np.array(sizes))
    assert values(evaluator.compute()) == alone
    evaluator.update(padded[1:2, :131], ids=ids[1:2], music=heard[1:2, :131])  # the same sample, padded otherwise
    assert len(evaluator) == 4
    junk = padded.copy()
    junk[1, 131:] = columns[0, 0]  # what a network makes of padded rows
    loud = heard.copy()
    loud[1, 131:, 34] = 1  # beats after the end do not belong to the sample
    evaluator.update(junk, ids=ids[:4], music=loud, lengths=sizes)
    assert len(evaluator) == 4
    evaluator.reset()
    evaluator.update(junk, ids=ids[:4], music=heard, lengths=sizes)
    assert values(evaluator.compute()) == alone
    evaluator.reset()
    with raises_message(UsageError, "padded", where=f"sample {ids[0]}"):
        evaluator.update(padded, ids=ids[:4], music=heard)
    for wrong in ([1, 2], [1, 2, 3, 0], [1, 2, 3, 161], [1.5, 2, 3, 4], {"edge151": sizes}):
        with raises_message(UsageError, "lengths"):
            evaluator.update(padded, ids=ids[:4], lengths=wrong)
    assert len(evaluator) == 0
    still = [f"{ids[0].split('@')[0]}@{k}+150" for k in (1, 2)]
    evaluator.update(np.zeros((2, LENGTH, 151)), still)  # an untrained network stands still: no padding
    assert len(evaluator) == 2


def test_music_of_another_length_or_rate(store: Store, evaluator: Evaluator, batch: Any) -> None:
    ids, columns, music = batch
    evaluator.reset()
    for wrong in (music[:, ::2], music.repeat(2, axis=1), music[:, :100], music[:, ::2, 34]):
        with raises_message(UsageError, "Evaluator"):
            evaluator.update(columns, ids=ids, music=wrong)
    with raises_message(UsageError, "Evaluator"):
        evaluator.update(columns, ids=ids, music=music[:, ::2], lengths=[LENGTH] * len(ids))
    evaluator.update(columns, ids=ids, music=music[:, :149])


def test_columns_that_do_not_fit_the_protocol(store: Store) -> None:
    with raises_message(UsageError, "smplx24", where="small"):
        Evaluator(store, "edge151", protocol="lodge-finedance")
    assert "Evaluator('dancedata', 0 samples)" in repr(Evaluator(store, "edge151", normalized=True))


def test_processes_agree_on_a_sample_that_they_generated_differently(store: Store, batch: Any) -> None:
    (a, b, c, d, *_), columns, _ = batch
    first, second = two(store)
    first.update(columns[:2], [a, b])
    second.update(columns[2:5], [a, c, d])
    with raises_message(UsageError, "processes"):
        gathered(first, second)
    gathered(first, second, repeated="first")
    assert len(first) == len(second) == 4
    assert values(first.compute()) == values(second.compute())


def test_ids_of_readers_keep_all_and_ids_of_clips_are_refused(store: Store, evaluator: Evaluator) -> None:
    """`batch["clip"]` under several windows of one clip used to leave all except the first out, without a word."""
    data = pytest.importorskip("torch.utils.data")
    from dancedata.torch import WindowDataset

    windows = WindowDataset(store, split="train", fields=("edge151", "librosa35"))
    evaluator.reset()
    for batch in data.DataLoader(windows, batch_size=7):
        evaluator.update(batch["edge151"], ids=batch["id"], music=batch["librosa35"])
    assert len(evaluator) == len(windows) > len(set(windows.windows.clip.tolist()))
    clips = set(windows.windows.clip.tolist())  # windows of one clip are not additional evidence
    assert {m.clip for m in evaluator._measured.values()} == {windows.store.clips()[k].id for k in clips}
    before = values(evaluator.compute())
    for batch in data.DataLoader(windows, batch_size=5):  # the same samples, in other batches: once is enough
        noise = 1e-6 * (-1) ** np.arange(151, dtype=np.float32)
        evaluator.update(batch["edge151"].numpy() + noise, ids=batch["id"], music=batch["librosa35"])
    assert values(evaluator.compute()) == before
    evaluator.reset()
    batch = next(iter(data.DataLoader(windows, batch_size=7)))
    with raises_message(UsageError, "number"):
        evaluator.update(batch["edge151"], ids=batch["clip"], music=batch["librosa35"])


def test_one_motion_to_other_music_is_another_sample(evaluator: Evaluator, batch: Any) -> None:
    (a, *_), columns, music = batch
    evaluator.reset()
    evaluator.update(columns[:1], [a], music=music[:1])
    with raises_message(UsageError, "number"):
        evaluator.update(columns[:1], [a], music=np.roll(music[:1], 3, axis=1))
    with raises_message(UsageError, "number"):
        evaluator.update(columns[:1, ::-1], [a], music=music[:1])
    evaluator.update(columns[:1, ::-1], [f"{a}~s1"], music=music[:1])
    assert len(evaluator) == 2


def test_the_pool_is_of_the_field_that_is_generated(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str | None] = []
    monkeypatch.setattr("dancedata.evaluation.evaluator.pool_for", lambda ask, *_, **__: asked.append(ask.field))
    Evaluator(store, "lodge139", normalized=True)
    Evaluator(store, normalized=True)
    assert asked == ["lodge139", "edge151"]

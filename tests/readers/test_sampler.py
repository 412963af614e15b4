"""EpochSampler: order, ranks, position, state."""

from collections.abc import Sequence
from itertools import islice
from typing import Any

import numpy as np
import pytest
from torch import distributed

from dancedata.core.errors import UsageError
from dancedata.torch import EpochSampler
from tests.messages import raises_message


def test_every_sample_once_and_a_new_order_every_epoch() -> None:
    sampler = EpochSampler(1000, seed=3)
    first, second = list(sampler), list(sampler)
    assert sorted(first) == sorted(second) == list(range(1000))
    assert first != second
    assert all(type(sample) is int for sample in first)
    assert (sampler.epoch, sampler.position) == (2, 0)


def test_order_is_unchanged() -> None:
    """Written down: a checkpoint must resume in the same order with any later version of numpy or of this."""
    assert EpochSampler(10, seed=0).order(0).tolist() == [4, 6, 3, 5, 2, 9, 1, 0, 7, 8]
    assert EpochSampler(10, seed=1).order(7).tolist() == [2, 3, 5, 1, 9, 7, 6, 4, 0, 8]


@pytest.mark.parametrize("n_samples", [0, 1, 3, 64, 1001])
@pytest.mark.parametrize("world_size", [1, 2, 3, 8])
@pytest.mark.parametrize("drop_last", [False, True])
def test_ranks_get_equally_many_and_share_nothing(n_samples: int, world_size: int, drop_last: bool) -> None:
    ranks = [
        EpochSampler(n_samples, seed=1, rank=rank, world_size=world_size, drop_last=drop_last)
        for rank in range(world_size)
    ]
    orders = [list(rank) for rank in ranks]
    share = n_samples // world_size if drop_last else -(-n_samples // world_size)
    assert [len(order) for order in orders] == [len(rank) for rank in ranks] == [share] * world_size
    everything = [sample for order in orders for sample in order]
    repeated = len(everything) - len(set(everything))
    assert repeated == max(0, share * world_size - n_samples)
    assert set(everything) <= set(range(n_samples))
    if not drop_last:
        assert set(everything) == set(range(n_samples))


def _where(state: dict[str, Any]) -> tuple[int, int]:
    return state["epoch"], state["position"]


def test_state_resumes() -> None:
    sampler = EpochSampler(50, seed=2)
    list(sampler)
    passed = iter(sampler)
    list(islice(passed, 17))
    state = sampler.state_dict()
    assert _where(state) == (1, 17)
    resumed = EpochSampler(50, seed=2)
    resumed.load_state_dict(state)
    assert list(resumed) == list(passed)
    assert resumed.state_dict() == sampler.state_dict()
    assert _where(sampler.state_dict()) == (2, 0)
    abandoned = iter(sampler)
    next(abandoned)
    sampler.load_state_dict(sampler.at(7, 9))
    assert len(list(abandoned)) == 49
    assert _where(sampler.state_dict()) == (7, 9)
    assert len(list(islice(sampler, 41))) == 41
    assert _where(sampler.state_dict()) == (8, 0), "the last sample that was handed out begins the next epoch"
    sampler.load_state_dict(sampler.at(3, 10))
    for epoch, where in ((3, (3, 10)), (5, (5, 0))):  # the same epoch keeps the position
        sampler.set_epoch(epoch)
        assert _where(sampler.state_dict()) == where
    assert list(sampler) == EpochSampler(50, seed=2).order(5).tolist()


def test_at_counts_consumed_samples() -> None:
    sampler = EpochSampler(10, rank=0, world_size=2)
    assert _where(sampler.at(4, 0)) == (4, 0)
    assert _where(sampler.at(4, 3)) == (4, 3)
    assert _where(sampler.at(4, 5)) == (5, 0)
    with raises_message(UsageError, "count"):
        sampler.at(4, 6)
    with raises_message(UsageError, "consumed"):
        sampler.at(4, -1)


@pytest.mark.parametrize(
    "state", [None, 3, {}, {"epoch": 0}, {"epoch": 0, "position": 11}, {"epoch": -1, "position": 0}]
)
def test_wrong_state(state: Any) -> None:
    sampler = EpochSampler(10)
    with raises_message(UsageError, "epoch"):
        sampler.load_state_dict(state)


@pytest.mark.parametrize(
    "wrong",
    [
        {"seed": -1}, {"seed": 0.5}, {"rank": 0}, {"world_size": 2}, {"rank": 2, "world_size": 2},
        {"rank": -1, "world_size": 2}, {"rank": 0, "world_size": 0}, {"rank": 0, "world_size": 10**30},
    ],
)  # fmt: skip
def test_wrong_arguments(wrong: dict[str, int]) -> None:
    with raises_message(UsageError, "seed|world_size|rank"):
        EpochSampler(10, **wrong)  # type: ignore[arg-type]


def test_takes_rank_and_size_from_distributed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(distributed, "get_rank", lambda: 2)
    monkeypatch.setattr(distributed, "get_world_size", lambda: 4)
    assert EpochSampler(10).order(0).tolist() == EpochSampler(10, rank=2, world_size=4).order(0).tolist()


class _Drawn(EpochSampler):
    """A sampler with an order of its own, as a `BalancedSampler` has."""


class _OfShards:
    shard_starts = (0, 10, 14, 19, 60)

    def __init__(self, n: int) -> None:
        self.n = n

    def __len__(self) -> int:
        return self.n


def test_blocks_end_where_shards_end_and_hold_neighbours() -> None:
    """Shards of 10, 4, 5, 41 and 40 samples in blocks of at most 20."""
    sampler = EpochSampler(_OfShards(100), seed=1, block=20)
    bounds = [0, 19, 32, 46, 60, 80, 100]
    for epoch in range(3):
        order = sampler.order(epoch)
        assert sorted(order.tolist()) == list(range(100))
        blocks = np.searchsorted(bounds, order, side="right")
        turns = blocks[np.flatnonzero(np.diff(blocks, prepend=0))]
        assert sorted(turns.tolist()) == [1, 2, 3, 4, 5, 6]  # each once, in one piece
        assert not any((np.diff(order[blocks == b]) > 0).all() for b in turns)  # shuffled
    assert sampler.order(0).tolist() != sampler.order(1).tolist()
    plain = EpochSampler(100, seed=1, block=20).order(0)
    assert {int(n) // 20 for n in plain[:20]} == {int(plain[0]) // 20}
    assert EpochSampler(0, block=5).order(0).tolist() == []
    assert EpochSampler(7, seed=1, block=7).order(0).tolist() == EpochSampler(7, seed=1).order(0).tolist()
    with raises_message(UsageError, "block"):
        EpochSampler(10, block=0)


@pytest.mark.parametrize("world_size", [1, 2, 8])
def test_ranks_share_each_block_and_resume(world_size: int) -> None:
    samplers = [
        EpochSampler(_OfShards(100), seed=1, block=20, rank=rank, world_size=world_size, drop_last=True)
        for rank in range(world_size)
    ]
    orders = [list(sampler) for sampler in samplers]
    assert len({index for order in orders for index in order}) == 100 // world_size * world_size
    samplers[0].load_state_dict(samplers[0].at(0, 7))
    assert list(samplers[0]) == orders[0][7:]


def test_blocks_are_announced_before_they_are_read() -> None:
    class Source(_OfShards):
        def prefetch(self, blocks: Sequence[Sequence[int]]) -> None:
            soon.append([set(map(int, indices)) for indices in blocks])

    soon: list[list[set[int]]] = []
    for number, index in enumerate(EpochSampler(Source(100), seed=1, block=20)):
        assert index in soon[-1][0]
        assert len(soon) == number // 20 + 1
    assert [len(block) for block in soon[0]] == [20, 20, 20]  # and the next two


@pytest.mark.parametrize(
    "differs",
    [{"seed": 3}, {"n": 51}, {"rank": 0, "world_size": 2}, {"block": 10}, {"shuffle": False}, {"kind": _Drawn}],
)
def test_a_position_of_another_order_is_refused(differs: dict[str, Any]) -> None:
    options: dict[str, Any] = {"n": 50, "seed": 2} | differs
    kind = options.pop("kind", EpochSampler)
    sampler = kind(options.pop("n"), **options)
    with raises_message(UsageError, "order"):
        sampler.load_state_dict(EpochSampler(50, seed=2).at(1, 7))
    sampler.load_state_dict(EpochSampler(50, seed=2).at(1, 0))
    assert _where(sampler.state_dict()) == (1, 0)

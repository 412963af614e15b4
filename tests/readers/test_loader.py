"""WindowDataset and EpochSampler in torch's DataLoader: workers, epochs, resuming."""

import multiprocessing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

from torch.utils.data import DataLoader

from dancedata.store.dataset import open_store
from dancedata.torch import EpochSampler, WindowDataset, Windows
from dancedata.torch.draws import mirrored_samples

pytestmark = [
    # Python 3.12 and later warn when a process with threads (torch's, numpy's) forks, as "fork" asks for.
    pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning"),
    # torch finds two workers too many on a machine with one core.
    pytest.mark.filterwarnings("ignore:This DataLoader will create:UserWarning"),
]
# forkserver pickles the dataset for new interpreters as spawn does, but imports torch once for all of them.
METHODS = [
    pytest.param(
        method,
        marks=[
            pytest.mark.skipif(method not in multiprocessing.get_all_start_methods(), reason="not here"),
            *([pytest.mark.nightly] if method == "spawn" else []),
        ],
    )
    for method in ("fork", "spawn", "forkserver")
]
MOTION, AUDIO = "edge151", "librosa35"


def seen(loader: DataLoader[Any]) -> list[tuple[int, bool]]:
    """Go through one epoch and return (index, mirrored) of every sample."""
    return [
        (int(index), bool(flag))
        for batch in loader
        for index, flag in zip(batch["index"], batch["mirrored"], strict=True)
    ]


@pytest.mark.parametrize("method", METHODS)
def test_every_window_once_with_the_values_of_the_store_and_the_draws_of_the_epoch(store_path, method):
    dataset = WindowDataset(store_path, windows=Windows(stride=3), scale=None, augment={"mirror": 0.5}, seed=9)
    assert len(dataset) >= 1000
    # Read here as well before the workers start: a file handle opened here must not reach them.
    dataset[0]
    loader = DataLoader(
        dataset, 64, num_workers=2, shuffle=True, persistent_workers=True, multiprocessing_context=method
    )
    store, windows = open_store(store_path), dataset.windows
    flags = {epoch: mirrored_samples(9, epoch, range(len(dataset)), 0.5) for epoch in (0, 5)}
    assert (flags[0] != flags[5]).any()
    for epoch in (0, 5, 0):
        dataset.set_epoch(epoch)
        found = []
        for batch in loader:
            found += list(zip(batch["clip"], batch["start"].tolist(), batch["length"].tolist(), strict=True))
            assert batch["mirrored"].tolist() == flags[epoch][batch["index"]].tolist()
            for nth, index in enumerate(batch["index"].tolist() if epoch else ()):
                for field in (AUDIO,) if flags[epoch][index] else (MOTION, AUDIO):
                    np.testing.assert_array_equal(batch[field][nth].numpy(), store.read(windows[index], field))
        assert sorted(found) == sorted((window.clip, window.start, window.length) for window in windows)
        assert len(set(found)) == len(windows)


def test_accelerate_resumes_in_the_middle_of_an_epoch(store_path: Path) -> None:
    accelerate = pytest.importorskip("accelerate", reason="Accelerate is not installed")

    def start() -> tuple[EpochSampler, Any]:
        dataset = WindowDataset(
            store_path, fields=(AUDIO,), windows=Windows(stride=90), augment={"mirror": 0.5}, seed=2
        )
        sampler = EpochSampler(dataset, seed=2, rank=0, world_size=1)
        loader = DataLoader(dataset, batch_size=8, sampler=sampler)
        return sampler, accelerate.Accelerator(cpu=True).prepare(loader)

    _, loader = start()
    expected = [seen(loader) for _ in range(3)]
    sampler, loader = start()
    sampler.load_state_dict(sampler.at(1, 16))
    loader.set_epoch(sampler.epoch)
    assert [seen(loader), seen(loader)] == [expected[1][16:], expected[2]]

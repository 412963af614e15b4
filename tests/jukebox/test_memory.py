"""Memory by accounting at real size, and what happens when a device has less than was thought."""

from typing import Any

import numpy as np
import pytest

from tests.messages import raises_message

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import torch

from dancedata.audio.jukebox import JukeboxConfig
from dancedata.audio.jukebox.network import memory
from dancedata.audio.networks.devices import Batches
from dancedata.core.errors import DanceDataError

REAL = JukeboxConfig()
HALF = torch.float16
GB = 10**9


@pytest.mark.parametrize("n_blocks", [1, 2, 3, 7, 66])
def test_any_number_of_blocks_can_be_away(n_blocks: int) -> None:
    block = memory.block_bytes(REAL, HALF)
    base = memory.fixed_bytes(REAL, HALF, 1722) + memory.clip_bytes(REAL, HALF, 1722)
    for n_resident in range(max(0, n_blocks - memory.N_SLOTS)):
        placement = memory.place(REAL, n_blocks, HALF, 1722, base + (n_resident + memory.N_SLOTS) * block)
        assert (len(placement.resident), sum(placement.resident)) == (n_blocks, n_resident)


OUT_OF_MEMORY = torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate 9 GiB. More text")


def _limited(room: int, seen: list[int], error: RuntimeError = OUT_OF_MEMORY) -> Any:
    def compute(part: list[int]) -> list[int]:
        seen.append(len(part))
        if len(part) > room:
            raise error
        return [10 * x for x in part]

    return compute


def test_batches_are_halved_when_memory_runs_out_and_stay_so() -> None:
    batches, seen = Batches(), []
    items = list(range(11))
    assert [x for part in batches.run(items, 8, _limited(3, seen)) for x in part] == [10 * x for x in items]
    assert seen == [8, 4, 2, 2, 2, 2, 2, 1]
    seen.clear()
    list(batches.run(items[:4], 8, _limited(3, seen)))
    assert seen == [2, 2]


def test_a_single_clip_that_does_not_fit() -> None:
    with raises_message(DanceDataError, "little"):
        list(Batches().run([1, 2], 2, _limited(0, [])))


def test_a_library_without_its_workspace_is_out_of_memory_and_other_errors_are_not() -> None:
    seen: list[int] = []
    blas = RuntimeError("CUDA error: CUBLAS_STATUS_ALLOC_FAILED when calling `cublasCreate(handle)`")
    assert [len(part) for part in Batches().run([1, 2, 3], 8, _limited(2, seen, blas))] == [1, 1, 1]
    with pytest.raises(RuntimeError, match="illegal memory access"):
        list(Batches().run([1, 2, 3], 8, _limited(2, [], RuntimeError("CUDA error: an illegal memory access"))))


def test_encoder_survives_running_out_of_memory(tiny_encoder: Any, noise: np.ndarray, monkeypatch: Any) -> None:
    original = tiny_encoder._prior.run

    def small(codes: torch.Tensor) -> Any:
        if len(codes) > 1:
            raise torch.cuda.OutOfMemoryError("CUDA out of memory.")
        return original(codes)

    expected = tiny_encoder(noise, 44100)[6]
    monkeypatch.setattr(tiny_encoder, "_batches", Batches())
    object.__setattr__(tiny_encoder._prior, "run", small)
    try:
        found = tiny_encoder.embed_batch([noise] * 5, 44100, batch_size=4)
    finally:
        object.__delattr__(tiny_encoder._prior, "run")
    assert len(found) == 5
    for one in found:
        np.testing.assert_array_equal(one[6], expected)


@pytest.mark.parametrize(
    ("gib", "n_codes", "precision", "blocks", "host_gb", "clips"),
    [(6, 1722, torch.float16, 35, 4.3, 2), (8, 8192, torch.float16, 48, 2.5, 1),
     (10, 1722, torch.float16, 66, 0, 5), (10, 8192, torch.float32, 62, 0.6, 1),
     (16, 8192, torch.float16, 66, 0, 17), (80, 8192, torch.float32, 66, 0, 32)],
)  # fmt: skip
def test_the_table_of_the_documentation(gib, n_codes, precision, blocks, host_gb, clips):
    free = (gib - 1) << 30
    placement = memory.place(REAL, 66, precision, n_codes, free)
    away = len(placement.resident) - sum(placement.resident)
    assert sum(placement.resident) == blocks
    assert round(away * memory.block_bytes(REAL, precision) / GB, 1) == host_gb
    assert memory.batch_size(REAL, precision, n_codes, free - placement.weight_bytes) == clips

"""Memory by accounting at real size, devices with less than was thought, and cards: who computes where."""

from typing import Any

import numpy as np
import pytest

from tests.messages import raises_message

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import torch

from dancedata.audio.jukebox import JukeboxConfig
from dancedata.audio.jukebox.feature import Jukebox
from dancedata.audio.jukebox.network import memory
from dancedata.audio.networks import devices as _devices
from dancedata.audio.networks.devices import Batches
from dancedata.building.fields.music import MusicField
from dancedata.building.signals import SignalId
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid, WindowSpec
from dancedata.files.regular_file import sha256_file

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


# ---- cards: who computes where, in what precision, and what is free there


FPS = FrameGrid.of(30)


@pytest.fixture
def two_cards(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[dict[str, str]]:
    """Two cards by number and identity."""
    cards = {"cuda:0": "card-a", "cuda:1": "card-b"}
    monkeypatch.setattr(torch.cuda, "device_count", lambda: len(cards))
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda d: SimpleNamespace(uuid=cards[d]))
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(_devices, "_held", [])
    _devices.claimed.cache_clear()
    yield cards
    for lock in _devices._held:
        os.close(lock)
    _devices.claimed.cache_clear()


def _claim(devices: tuple[str, ...]) -> str | None:
    """Claim as another process would."""
    _devices.claimed.cache_clear()
    return _devices.claimed(devices)


def test_one_process_a_card(two_cards: dict[str, str], tiny: SimpleNamespace) -> None:
    feature = Jukebox(weights=tiny.folder, layer=6).resolved(sha256_file)
    assert feature.precision == "fp16"
    assert feature.windows_per_call == 32
    assert _field(feature).workers(16) == 2
    assert [_claim(tuple(two_cards)) for _ in range(3)] == ["cuda:0", "cuda:1", "cuda:0"]
    one = Jukebox(weights=tiny.folder, layer=6, device="cuda:1")
    assert one.workers(16) == 1
    assert Jukebox(weights=tiny.folder, layer=6, device="cpu").resolved(sha256_file).precision == "fp32"


def test_a_card_is_known_by_itself_not_by_its_number(two_cards: dict[str, str]) -> None:
    # A batch system shows each of its jobs other cards under the same numbers.
    assert [_claim(tuple(two_cards)) for _ in range(2)] == ["cuda:0", "cuda:1"]
    two_cards.update({"cuda:0": "card-c", "cuda:1": "card-d"})
    assert [_claim(tuple(two_cards)) for _ in range(2)] == ["cuda:0", "cuda:1"]


def test_memory_that_torch_keeps_counts_as_free(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = [3 << 30]
    monkeypatch.setattr(torch.cuda, "empty_cache", kept.clear)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _device: ((8 << 30) - sum(kept), 8 << 30))
    assert _devices.free_memory(torch.device("cuda:0")) == (8 << 30) - _devices.RESERVE_BYTES
    assert _devices.free_memory(torch.device("cpu")) is None


def test_impossible_settings_are_reported_before_a_build(tiny: SimpleNamespace, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"model_type": "jukebox"}')
    with raises_message(SourceError, "trained"):
        Jukebox(weights=tmp_path, layer=6).resolved(sha256_file)
    for wrong, message in (
        ({"layer": 7}, "1 to 6"),
        ({"device": "cuda:9"}, "does not exist"),
        ({"device": "mps"}, "unsupported device"),
        ({"device": "tpu9"}, "unknown device"),
    ):
        with pytest.raises(UsageError, match=message):
            Jukebox(**{"weights": tiny.folder, "layer": 6, **wrong}).resolved(sha256_file)  # type: ignore[arg-type]


def test_one_network_a_process_and_the_one_before_goes_first(tiny, monkeypatch):
    networks: dict[str, Any] = {"hf": (None, None)}
    monkeypatch.setattr("dancedata.audio.networks.feature._networks", networks)
    feature = Jukebox(weights=tiny.folder, layer=3, device="cpu").resolved(sha256_file)
    first = feature._encoder(1722)
    assert first is feature._encoder(1725)  # a code more or less, as sample rates have it
    assert first.max_codes == 1728
    seen: list[set[str]] = []
    plain = Jukebox.weights_hash
    monkeypatch.setattr(Jukebox, "weights_hash", lambda *given: (seen.append(set(networks)), plain(*given))[1])
    other = replace(feature, layer=2)._encoder(1722)
    assert other is not first
    assert seen == [{"hf"}]
    assert networks["jukebox"][1] is other
    assert feature._encoder(100_000).max_codes == 8192


def _field(feature: Jukebox, windows: WindowSpec | None = None) -> MusicField:
    return MusicField("jukebox", FPS, feature, windows=windows)


def _key(feature: Jukebox) -> str:
    return _field(feature).song_key(None, "a")


def test_tempo_is_not_in_the_key(tiny: SimpleNamespace) -> None:
    feature = Jukebox(weights=tiny.folder, layer=6, device="cpu").resolved(sha256_file)
    tracks, windows = (_field(feature, windows) for windows in (None, WindowSpec(150, 15, FPS)))
    assert tracks.song_key(120.0, "a") == tracks.song_key(None, "a") != tracks.song_key(None, "b")
    one, other = (SignalId(Path("song.wav"), "file", sha, 44100, 10**6) for sha in ("a", "b"))
    assert windows.slice_key(120.0, one, 0) == windows.slice_key(None, one, 0) != windows.slice_key(None, other, 0)


@pytest.mark.parametrize(
    "change", [{"layer": 5}, {"precision": "bf16"}, {"overlap_s": 5.0}, {"weights_sha256": "0" * 64}]
)
def test_settings_that_change_numbers_are_in_the_key(tiny: SimpleNamespace, change: dict[str, Any]) -> None:
    feature = Jukebox(weights=tiny.folder, layer=6, device="cpu").resolved(sha256_file)
    other = replace(feature, **change)
    assert _key(feature) != _key(other)
    elsewhere = replace(feature, weights=Path("/other"), device="cuda:1", batch_size=7)
    assert _key(feature) == _key(elsewhere)

"""Cards, without one: who computes where, in what precision, and what is free there."""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.messages import raises_message

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import torch

from dancedata.audio.jukebox.feature import Jukebox
from dancedata.audio.networks import devices as _devices
from dancedata.building.fields.music import MusicField
from dancedata.building.signals import SignalId
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.grid import FrameGrid, WindowSpec
from dancedata.files.regular_file import sha256_file

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

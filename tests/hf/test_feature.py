"""The recipe feature: windows, chunks, batches, silence, keys, memory."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import dancedata
from dancedata.audio.hf import HuggingFace
from dancedata.audio.hf.encoder import HuggingFaceEncoder
from dancedata.audio.hf.loading import place, weight_bytes
from dancedata.building.fields.music import MusicField
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.files.documents import document_of
from dancedata.files.regular_file import sha256_file
from tests.messages import raises_message

from .conftest import ONE_OF_EACH, noise, settings, song

FPS = FrameGrid.of(30)


def _spied(own: HuggingFaceEncoder, monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, ...]]:
    """Shapes of all batches; a call with a mask fails."""
    seen: list[tuple[int, ...]] = []
    plain = own._network.forward

    def watched(*args: Any, **kwargs: Any) -> Any:
        assert not {k for k, v in kwargs.items() if "mask" in k and v is not None}
        assert len(args) == 1
        seen.append(tuple(args[0].shape))
        return plain(*args, **kwargs)

    monkeypatch.setattr(own._network, "forward", watched)
    return seen


def test_batches_are_of_equal_length_and_have_no_mask(encoder, monkeypatch):
    own = encoder("wav2vec2-large", chunk_s=1, overlap_s=0.2)
    seen = _spied(own, monkeypatch)
    signals = [noise(1.92, 16_000, seed) for seed in range(5)]
    found = {}
    for size in (1, 2, 7):
        seen.clear()
        found[size] = own.rows(signals, 16_000, FPS, 57, finish=lambda rows: rows, batch_size=size)
        assert all(shape[0] <= size for shape in seen)
        # Three chunks of each signal; the last ends with the signal, at a whole number of hops here.
        assert {shape[1] for shape in seen} == {16_000}
        assert sum(shape[0] for shape in seen) == 5 * len(own._chunks(len(signals[0])))
    for size in (2, 7):
        np.testing.assert_allclose(found[size], found[1], atol=1e-5)
    alone = own.rows(signals[3:4], 16_000, FPS, 57, finish=lambda rows: rows)
    np.testing.assert_array_equal(alone[0], found[1][3])


def test_batches_are_halved_when_memory_runs_out(encoder, monkeypatch):
    own = encoder("hubert")
    plain, seen = own._network.forward, []

    def small(inputs: torch.Tensor) -> Any:
        seen.append(len(inputs))
        if len(inputs) > 2:
            raise torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate")
        return plain(inputs)

    monkeypatch.setattr(own._network, "forward", small)
    signals = [noise(0.3, 16_000, seed) for seed in range(8)]
    rows = own.rows(signals, 16_000, FPS, 9, finish=lambda rows: rows, batch_size=8)
    assert seen[:3] == [8, 4, 2]
    assert len(rows) == 8


OFFSETS = pytest.mark.parametrize("offset_s", [0, 0.31])


def _seams(whole: HuggingFaceEncoder, cut: HuggingFaceEncoder) -> np.ndarray:
    """By how much each frame of chunks differs from that of 3.5 s at once, in standard deviations."""
    rate = whole.settings.family.sample_rate
    samples = noise(3.5, rate)
    one, two = whole.frames(samples, rate), cut.frames(samples, rate)
    np.testing.assert_allclose(two.stamps_s, one.stamps_s, atol=1e-9)  # no drift, no frame twice or missing
    return np.asarray(np.abs(two.values - one.values).max(axis=1) / one.values.std())


@pytest.mark.parametrize(
    ("kind", "layers", "tolerance"),
    # Measured: 1e-6 to 2e-6, rounding. EnCodec at 32 kHz sees 0.25 s of the future, and its LSTM the past: 5e-5.
    [("wav2vec2-large", 0, 1e-5), ("encodec24", "last", 1e-5), ("dac", "last", 1e-5), ("encodec32", "last", 2e-4)],
)
@OFFSETS
def test_seams(kind, layers, tolerance, offset_s, encoder):
    """Convolutions see the same in chunks as in the whole."""
    cut = encoder(kind, layers=layers, chunk_s=2 + offset_s, overlap_s=1.2)
    assert _seams(encoder(kind, layers=layers), cut).max() < tolerance


@OFFSETS
def test_seams_of_a_transformer(offset_s: float, encoder: Callable[..., HuggingFaceEncoder]) -> None:
    """Attention alone differs: it averages over what it is given; all else is as exact as the front end.

    Weights are drawn so that attention adds as much as comes in: the median was 0.08 and 0.13 with two draws of them.
    """
    pair = [
        encoder("wav2vec2-large", fresh=True, **keys) for keys in ({}, {"chunk_s": 2 + offset_s, "overlap_s": 1.2})
    ]
    error = _seams(*pair)
    assert np.median(error) < 0.2
    for one in pair:
        for block in one._network.encoder.layers:
            torch.nn.init.zeros_(block.attention.out_proj.weight)
    assert _seams(*pair).max() < 1e-5


def test_group_norm_is_continuous_at_seams(encoder: Callable[..., HuggingFaceEncoder]) -> None:
    own = encoder("mert", chunk_s=3, overlap_s=1.6)
    values = own.frames(noise(7, 24_000), 24_000).values
    assert np.isfinite(values).all()
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    assert steps.max() < 3 * np.median(steps)


@pytest.mark.parametrize("kind", ["mert", "dac", "whisper", "muq"])
def test_windows_are_songs_of_their_own(kind: str, feature: Callable[..., HuggingFace]) -> None:
    made, signal = feature(kind, store="float32"), song(1.2)
    starts = np.array([5_000, 11_025])
    rows = made.extract_windows(signal, starts, 11_025, FPS, 15)
    assert (rows.shape, rows.dtype) == ((2, 15, made.columns.width), np.float32)
    for own, start in zip(rows, starts, strict=True):
        wanted = made.extract(signal.part(int(start), int(start) + 11_025), FPS)
        np.testing.assert_allclose(own, wanted[:15], atol=1e-6)
    assert made.extract_windows(signal, np.array([], int), 11_025, FPS, 15).shape == (0, 15, made.columns.width)


@pytest.mark.parametrize("kind", ONE_OF_EACH)
def test_silence_is_finite_and_a_blink_is_too_short(kind: str, feature: Callable[..., HuggingFace]) -> None:
    made = feature(kind)
    rows = made.extract(AudioSignal(np.zeros(11_025, np.float32), 22_050), FPS)
    assert np.isfinite(rows).all()
    # 10 ms; EnCodec's frames at 48 kHz are shorter.
    short = AudioSignal(np.zeros(220 if kind != "encodec48" else 140, np.float32), 22_050)
    with raises_message(DataError, "signal", reason="short_audio"):
        made.extract(short, FPS)


def test_values_beyond_float16_are_never_stored(feature: Callable[..., HuggingFace]) -> None:
    with raises_message(DataError, "float16", reason="overflow"):
        feature("hubert").in_dtype(np.array([[1.0, 7e4]], np.float32), "fix")
    assert feature("hubert", store="float32").in_dtype(np.array([[7e4]], np.float32), "fix").dtype == np.float32


def test_keys_know_the_weights_and_not_where_they_are(model, feature, tmp_path):
    def key(made: HuggingFace) -> str:
        return MusicField("hf.mert", FPS, made).song_key(None, "signal")

    first = feature("mert", layers=(2,))
    moved = tmp_path / "renamed"
    shutil.copytree(model("mert"), moved)
    same = HuggingFace(model=str(moved), layers=(2,), device="cpu", batch_size=7).resolved(sha256_file)
    assert key(same) == key(first)
    assert "model" not in document_of(first)
    assert document_of(first)["precision"] == "fp32"
    changes: list[dict[str, Any]] = [
        {"layers": (1,)}, {"chunk_s": 20}, {"overlap_s": 2}, {"precision": "bf16"}, {"store": "float32"},
        {"normalize": "none"}, {"resample": "linear"}, {"reduce": "mean"},
    ]  # fmt: skip
    others = [feature("mert", **{"layers": (2,), **change}) for change in changes]
    assert len({key(made) for made in (first, *others)}) == len(others) + 1
    weights = bytearray((moved / "pytorch_model.bin").read_bytes())
    weights[-4_000] ^= 1
    (moved / "pytorch_model.bin").write_bytes(weights)
    changed = HuggingFace(model=str(moved), layers=(2,), device="cpu").resolved(sha256_file)
    assert key(changed) != key(first)
    with raises_message(UsageError, "omit", where="renamed"):
        HuggingFace(model=str(moved), model_sha256=first.model_sha256, device="cpu").resolved(sha256_file)


def test_from_python(model: Callable[[str], Path], encoder: Callable[..., HuggingFaceEncoder]) -> None:
    signal = song(1.2)
    rows = dancedata.features(
        signal, "hf", fps=30, model=str(model("mert")), layers=[2], precision="fp32", device="cpu", store="float32"
    )
    assert rows.shape == (36, 24)
    own = encoder("mert", layers=(2,))
    wanted = own.rows([signal.samples], 22_050, FPS, 36, finish=lambda rows: rows)[0]
    np.testing.assert_allclose(rows, wanted, atol=1e-5)
    with raises_message(UsageError, "fp16"):
        dancedata.features(signal, "hf", model=str(model("mert")), precision="fp16", device="cpu")


def test_bf16_equals_transformers_in_bf16(model: Callable[[str], Path]) -> None:
    import transformers

    samples = noise(0.5, 16_000)
    own = HuggingFaceEncoder(settings(model("hubert")), device="cpu", precision="bf16").frames(samples, 16_000)
    network = transformers.HubertModel.from_pretrained(model("hubert"), dtype=torch.bfloat16).eval()
    inputs = (samples - samples.mean()) / np.sqrt(samples.var() + 1e-7)
    with torch.inference_mode():
        wanted = network(torch.from_numpy(inputs)[None].to(torch.bfloat16)).last_hidden_state[0].float()
    np.testing.assert_array_equal(own.values, wanted)


def test_blocks_that_do_not_fit_stay_on_the_host(encoder: Callable[..., HuggingFaceEncoder]) -> None:
    pytest.importorskip("accelerate")
    samples = noise(0.4, 16_000)
    own = encoder("hubert", fresh=True)
    wanted = own.frames(samples, 16_000).values
    own._network = place(own._network, torch.device("cpu"), budget=weight_bytes(own._network) // 2)
    assert any(p.device.type == "meta" for p in own._network.parameters())  # Accelerate holds them elsewhere
    np.testing.assert_array_equal(own.frames(samples, 16_000).values, wanted)


def test_memory_is_flat(encoder: Callable[..., HuggingFaceEncoder], monkeypatch: pytest.MonkeyPatch) -> None:
    """No batch is longer than a chunk, for any song; rows that are done take the type that is stored."""
    own = encoder("wav2vec2-large", chunk_s=2, overlap_s=0.4)
    seen = _spied(own, monkeypatch)
    finished: list[int] = []

    def finish(rows: np.ndarray) -> np.ndarray:
        finished.append(len(rows))
        return rows.astype(np.float16)

    for seconds in (5, 20):
        seen.clear()
        finished.clear()
        rows = own.rows([noise(seconds, 16_000)], 16_000, FPS, 30 * seconds, finish=finish)[0]
        assert len(rows) == 30 * seconds
        assert max(np.prod(shape) for shape in seen) == 32_000
        assert max(finished) <= 62  # those of a chunk

"""Equality with the reference (jukemirlib 98223a6 on tiny random weights), however the checkpoint is loaded."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("accelerate")
pytest.importorskip("safetensors")

import torch

from dancedata.audio.jukebox import JukeboxEncoder
from dancedata.audio.jukebox.network.memory import block_bytes, clip_bytes, fixed_bytes
from dancedata.audio.jukebox.network.tensors import POSITIONS
from dancedata.audio.jukebox.weights.loading import load_conditioning, open_openai

CLIPS = ("5s", "odd", "short", "silence", "stereo48k")
# The reference's own noise floor is about 1e-5 at a standard deviation of 3.
TOLERANCE = 1e-4
MARGIN = 2e-5


@pytest.fixture(scope="module")
def encoder(golden: SimpleNamespace) -> JukeboxEncoder:
    return _encoder(golden)


def _encoder(golden: SimpleNamespace, precision: str = "fp32", **keys: Any) -> JukeboxEncoder:
    keys = {"layers": (1, 2, 3, 6), "device": "cpu", "precision": precision, **keys}
    return JukeboxEncoder(golden.folder, **keys)


def _frames(encoder: JukeboxEncoder, codes: list[np.ndarray], batch_size: int | None = None) -> list[dict]:
    """The last steps of embedding, given the codes."""
    return encoder._in_batches([np.asarray(c, dtype=np.int64) for c in codes], 30, batch_size)


def _codes(golden: SimpleNamespace, clip: str) -> np.ndarray:
    return golden.expected[clip]["z"][: golden.config.n_ctx]


@pytest.mark.parametrize("clip", CLIPS)
def test_codes(golden: SimpleNamespace, encoder: JukeboxEncoder, clip: str) -> None:
    codes = encoder.encode(*golden.audio(clip))
    expected = golden.expected[clip]
    assert codes.dtype == np.int64
    assert codes.shape == expected["z"].shape
    clear = expected["z_margin"] > MARGIN
    assert clear.sum() >= len(codes) - 2
    np.testing.assert_array_equal(codes[clear], expected["z"][clear])


def test_conditioning(golden: SimpleNamespace) -> None:
    checkpoint = open_openai(golden.folder, golden.config)
    start, positions = load_conditioning(checkpoint.prior, golden.config, golden.config.n_ctx)
    learnt = checkpoint.prior.read(POSITIONS, golden.config.n_ctx)
    np.testing.assert_array_equal(start.numpy(), golden.conditioning["y_cond"].ravel())
    x_cond = torch.from_numpy(golden.conditioning["x_cond"].reshape(golden.config.n_ctx, -1))
    np.testing.assert_array_equal(positions.numpy(), (x_cond + learnt).numpy())


@pytest.mark.parametrize("clip", CLIPS)
def test_activations(golden: SimpleNamespace, encoder: JukeboxEncoder, clip: str) -> None:
    expected = golden.expected[clip]
    found = encoder.activations(_codes(golden, clip))
    rows = expected.get("act_index", slice(None))
    for layer in golden.manifest[clip]["layers"]:
        assert found[layer].dtype == np.float32
        assert np.abs(found[layer][rows] - expected[f"act_{layer}"]).max() <= TOLERANCE


@pytest.mark.parametrize("clip", CLIPS)
def test_features(golden: SimpleNamespace, encoder: JukeboxEncoder, clip: str) -> None:
    (found,) = _frames(encoder, [_codes(golden, clip)])
    assert found[6].shape == (golden.manifest[clip]["frames"], golden.config.width)
    assert np.abs(found[6] - golden.expected[clip]["final"]).max() <= TOLERANCE


@pytest.mark.parametrize("clip", ["5s", "odd", "short", "silence"])
def test_from_samples_to_features(golden: SimpleNamespace, encoder: JukeboxEncoder, clip: str) -> None:
    # The clips without a near-tie between codes.
    found = encoder(*golden.audio(clip))
    assert np.abs(found[6] - golden.expected[clip]["final"]).max() <= TOLERANCE


def test_beyond_the_limit_as_the_reference_does(whole_golden: SimpleNamespace) -> None:
    """The whole context, 8192 codes: codes, activations, features, and the end of 24 s that is dropped."""
    encoder, golden = _encoder(whole_golden), whole_golden
    test_codes(golden, encoder, "24s")
    test_activations(golden, encoder, "24s")
    test_features(golden, encoder, "24s")
    found = encoder(*golden.audio("24s"), too_long="truncate")
    assert np.abs(found[6] - golden.expected["24s"]["final"]).max() <= TOLERANCE


@pytest.mark.parametrize(("precision", "bound"), [("fp16", 2e-3), ("bf16", 2e-2)])
def test_half_precision(golden: SimpleNamespace, precision: str, bound: float) -> None:
    encoder = _encoder(golden, precision, layers=(6,))
    for clip, found in zip(CLIPS, _frames(encoder, [_codes(golden, c) for c in CLIPS]), strict=True):
        expected = golden.expected[clip]["final"]
        rms = np.sqrt(np.mean((found[6] - expected) ** 2))
        assert 0 < rms / expected.std() <= bound


def test_layers_in_any_order(golden: SimpleNamespace) -> None:
    layers = (2, 1, 6, 3)  # jukemirlib returns only the first of layers that do not ascend.
    found = _encoder(golden, layers=layers).activations(_codes(golden, "short"))
    assert tuple(found) == layers
    rows = golden.expected["short"].get("act_index", slice(None))
    for layer in layers:
        assert np.abs(found[layer][rows] - golden.expected["short"][f"act_{layer}"]).max() <= TOLERANCE


@pytest.mark.parametrize("resident", [0, 3])
@pytest.mark.parametrize("precision", ["fp32", "fp16"])
def test_blocks_on_the_host(golden: SimpleNamespace, encoder: JukeboxEncoder, resident: int, precision: str) -> None:
    config, dtype = golden.config, {"fp32": torch.float32, "fp16": torch.float16}[precision]
    fixed = fixed_bytes(config, dtype, 1722) + clip_bytes(config, dtype, 1722)
    # Two blocks' room is for those that come and go.
    budget = fixed + (resident + 2) * block_bytes(config, dtype)
    streamed = _encoder(golden, precision, max_codes=1722, memory_budget=budget)
    whole = encoder if precision == "fp32" else _encoder(golden, precision)
    if resident + 2 < config.depth:
        assert sum(streamed.placement.resident) == resident
    for clip in ("short", "odd"):  # two runs: what comes and goes is used again
        codes = _codes(golden, clip)
        expected = whole.activations(codes)
        for layer, found in streamed.activations(codes).items():
            np.testing.assert_array_equal(found, expected[layer])

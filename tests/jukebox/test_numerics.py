"""The parts against plain formulas: attention, resampling, codes, the block; and the fp32 guard."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from tests.messages import raises_message

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import scipy.signal
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.audio.jukebox.clips import n_frames, resampling_matrix
from dancedata.audio.jukebox.encoder import JukeboxOverflowError
from dancedata.audio.jukebox.network.tensors import CODEBOOK
from dancedata.audio.jukebox.network.transformer import COLUMN, PREVIOUS_ROW, ROW, factored_attention
from dancedata.audio.jukebox.weights.loading import VqEncoder
from dancedata.audio.networks.devices import exact_float32
from dancedata.testing.jukebox import TINY


def _allowed(kind: int, n: int, row: int) -> np.ndarray:
    """(n, n) which key each query sees, straight from the definition."""
    t, s = np.arange(n)[:, None], np.arange(n)[None]
    r, c, r2, c2 = t // row, t % row, s // row, s % row
    return {ROW: (r == r2) & (c2 <= c), COLUMN: (c == c2) & (r2 <= r), PREVIOUS_ROW: r2 == r - 1}[kind]


@pytest.mark.parametrize("kind", [ROW, COLUMN, PREVIOUS_ROW])
@pytest.mark.parametrize(("n_clips", "n_rows"), [(1, 1), (1, 4), (3, 1), (3, 4)])
def test_attention_is_masked_softmax(kind: int, n_clips: int, n_rows: int) -> None:
    heads, width, row = 2, 6, 8
    n = n_rows * row
    qkv = torch.randn(n_clips * n, 3 * width, generator=torch.Generator().manual_seed(kind))
    found = factored_attention(qkv, kind, n_clips=n_clips, heads=heads, row_length=row).view(n_clips, n, width)
    allowed = torch.from_numpy(_allowed(kind, n, row))
    for clip, one in enumerate(qkv.view(n_clips, n, 3, heads, width // heads).double()):
        for head in range(heads):
            q, k, v = one[:, :, head].unbind(1)
            scores = (q @ k.T / (width // heads) ** 0.5).masked_fill(~allowed, -torch.inf)
            weights = torch.nan_to_num(torch.softmax(scores, 1))  # nothing to attend to: the zero vector
            part = slice(head * width // heads, (head + 1) * width // heads)
            torch.testing.assert_close(found[clip, :, part].double(), weights @ v, rtol=0, atol=1e-6)


def test_half_precision_products_of_large_queries_do_not_overflow() -> None:
    # 300 * 300 * 3 is beyond fp16 before the scale, as the reference computes it.
    qkv = torch.full((8, 18), 300.0, dtype=torch.float16)
    found = factored_attention(qkv, ROW, n_clips=1, heads=2, row_length=8)
    torch.testing.assert_close(found, torch.full((8, 6), 300.0, dtype=torch.float16))


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 400), st.integers(1, 400))
def test_resampling_is_scipys(n_in: int, n_out: int) -> None:
    x = np.random.default_rng(n_in).standard_normal((n_in, 3))
    found = resampling_matrix(n_in, n_out) @ x
    np.testing.assert_allclose(found, scipy.signal.resample(x, n_out), rtol=0, atol=1e-5)


def test_frames_of_a_clip() -> None:
    rate = 344.53125
    assert [n_frames(n, 30, rate) for n in (1, 1711, 1712, 1722, 1723, 8192)] == [1, 149, 150, 150, 151, 714]


def test_first_of_equal_codes_wins() -> None:
    generator = torch.Generator().manual_seed(0)
    codebook = torch.randn(8, 4, generator=generator)
    encoder = VqEncoder(TINY, {CODEBOOK: torch.cat([codebook, codebook])})
    assert encoder._nearest(codebook[[5, 0, 7]]).tolist() == [5, 0, 7]


def test_long_clips_are_quantised_in_parts(tiny_encoder: Any) -> None:
    vectors = torch.randn(3000, TINY.code_width, generator=torch.Generator().manual_seed(0))
    distances = torch.cdist(vectors.double(), tiny_encoder._vqvae._codebook)
    assert torch.equal(tiny_encoder._vqvae._nearest(vectors), distances.argmin(1))


@pytest.mark.parametrize("setting", ["highest", "high", "medium"])
def test_guard_restores_the_programs_setting(setting: str) -> None:
    before = torch.get_float32_matmul_precision()
    tf32 = torch.backends.cudnn.allow_tf32
    try:
        torch.set_float32_matmul_precision(setting)
        with exact_float32():
            assert torch.get_float32_matmul_precision() == "highest"
            assert not torch.backends.cudnn.allow_tf32
        assert torch.get_float32_matmul_precision() == setting
        assert torch.backends.cudnn.allow_tf32 == tf32
    finally:
        torch.set_float32_matmul_precision(before)


@pytest.mark.skipif(not hasattr(torch.backends.cudnn, "conv"), reason="the newer switches are of torch 2.9")
def test_guard_with_the_newer_switches() -> None:
    # Each in a separate process: a switch may report its parent's value, and could not be restored.
    code = """
import os, torch
from dancedata.audio.networks.devices import exact_float32
b = torch.backends
owners = (b.cuda.matmul, b.cudnn.conv, b.mkldnn.conv, b.mkldnn.matmul)
for switch in (b, b.cudnn, b.cudnn.conv, b.cuda.matmul):
    for value in ("tf32", "ieee"):
        if not os.fork():
            switch.fp32_precision = value
            before = [owner.fp32_precision for owner in owners]
            with exact_float32(), exact_float32():
                assert all(owner.fp32_precision in ("ieee", "none") for owner in owners)
                assert b.cudnn.conv.fp32_precision == "ieee" and b.cudnn.deterministic
            assert [owner.fp32_precision for owner in owners] == before and not b.cudnn.deterministic
            os._exit(0)
        assert os.wait()[1] == 0, (switch, value)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_guard_sums_half_precision_in_fp32() -> None:
    matmul = torch.backends.cuda.matmul
    before = matmul.allow_fp16_reduced_precision_reduction, matmul.allow_bf16_reduced_precision_reduction
    assert before == (True, True)
    with exact_float32():
        assert not matmul.allow_fp16_reduced_precision_reduction
        assert not matmul.allow_bf16_reduced_precision_reduction
    assert before == (matmul.allow_fp16_reduced_precision_reduction, matmul.allow_bf16_reduced_precision_reduction)


@pytest.mark.parametrize("place", ["attn_c_attn_b", "attn_c_attn_b of keys", "mlp_c_fc_b", "attn_c_proj_b"])
def test_overflow_in_fp16_is_an_error_with_a_fix(tiny: Any, place: str) -> None:
    from dancedata.audio.jukebox import JukeboxEncoder

    def encoder(precision: str) -> Any:
        options = {"layers": (2, 6), "device": "cpu", "precision": precision}
        made = JukeboxEncoder(tiny.folder, **options)
        bias = getattr(made._prior.stream.blocks[3], place.split(" ")[0])
        if "keys" in place:
            # An infinite key at which all queries look from the far side has no weight: it would go unseen.
            bias[10:20] = -60000.0
            bias[:10] = 100.0
            made._prior.stream.blocks[3].attn_c_attn_w[:, 10:20] *= 40000.0
        else:
            bias[:] = 65000.0
            made._prior.stream.blocks[3].mlp_c_fc_w.mul_(1000.0)
            made._prior.stream.blocks[3].attn_c_proj_w.mul_(1000.0)
        return made

    codes = np.arange(64)
    with raises_message(JukeboxOverflowError, "bf16"):
        encoder("fp16").activations(codes)
    assert np.isfinite(encoder("bf16").activations(codes)[6]).all()


def test_weights_that_are_not_numbers_are_an_error_too(tiny: Any) -> None:
    from dancedata.audio.jukebox import JukeboxEncoder

    encoder = JukeboxEncoder(tiny.folder, layers=(6,), device="cpu")
    encoder._prior.stream.blocks[1].ln_0_bias[0] = torch.nan
    with raises_message(JukeboxOverflowError, "activations"):
        encoder.activations([1, 2, 3])

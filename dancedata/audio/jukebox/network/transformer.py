"""One block of the prior."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn.functional import layer_norm, silu

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.network.attention import factored_attention
from dancedata.audio.jukebox.network.precision import add_product, product
from dancedata.audio.jukebox.network.tensors import BLOCKS, block_tensors

# Jukebox's GELU is u * sigmoid(1.702 u) = silu(1.702 u) / 1.702. The factors go into the two products around it.
GELU_SLOPE = 1.702
NORM_EPSILON = 1e-5


class Block(nn.Module):
    """h <- h + a + m; a = attention of norm(h), m = MLP of norm(h + a).

    Its parameters have the names of the file, with "_" for ".": ``attn_c_attn_w`` and so on.

    Parameters
    ----------
    config
        Sizes.
    index
        From 0; decides the attention pattern.
    precision
        Type of the factors of matrix products. In fp32, weights keep their stored type, which is exact and takes half
        the memory; biases and norms are fp32.
    """

    attn_c_attn_w: torch.Tensor
    attn_c_attn_b: torch.Tensor
    attn_c_proj_w: torch.Tensor
    attn_c_proj_b: torch.Tensor
    mlp_c_fc_w: torch.Tensor
    mlp_c_fc_b: torch.Tensor
    mlp_c_proj_w: torch.Tensor
    mlp_c_proj_b: torch.Tensor

    def __init__(self, config: JukeboxConfig, index: int, precision: torch.dtype) -> None:
        super().__init__()
        self.kind = index % 3
        self.heads, self.row_length = config.heads, config.row_length
        self.precision = precision
        self.specs = block_tensors(config, index)
        for spec in self.specs:
            stored = getattr(torch, spec.dtype)
            empty = torch.empty(spec.shape, dtype=self.kept_dtype(spec.name, stored))
            self.register_parameter(parameter_name(spec.name), nn.Parameter(empty, requires_grad=False))

    def kept_dtype(self, name: str, stored: torch.dtype) -> torch.dtype:
        """Return the type in memory of a tensor of the file."""
        if name.endswith(".w"):
            return stored if self.precision == torch.float32 else self.precision
        return self.precision if name.endswith(".b") else torch.float32

    def forward(self, h: torch.Tensor, n_clips: int) -> torch.Tensor | None:
        """Change the residual stream h (n_clips * L, W) float32 in place; L is a multiple of the row length.

        Returns
        -------
        torch.Tensor or None
            In fp16, () float32: the largest key, infinite if keys overflowed. Any other overflow reaches h, but a
            softmax weight of 0 can hide an infinite key. In other types None: their range is that of h.
        """
        qkv = product(self._norm(h, "ln_0"), self.attn_c_attn_w, self.attn_c_attn_b)
        attended = factored_attention(qkv, self.kind, n_clips=n_clips, heads=self.heads, row_length=self.row_length)
        largest = _largest_key(qkv) if self.precision == torch.float16 else None
        del qkv
        add_product(h, attended, self.attn_c_proj_w, self.attn_c_proj_b)
        del attended
        hidden = product(self._norm(h, "ln_1"), self.mlp_c_fc_w, self.mlp_c_fc_b, alpha=GELU_SLOPE)
        add_product(h, silu(hidden, inplace=True), self.mlp_c_proj_w, self.mlp_c_proj_b, alpha=1 / GELU_SLOPE)
        return largest

    def _norm(self, h: torch.Tensor, name: str) -> torch.Tensor:
        weight, bias = getattr(self, f"{name}_weight"), getattr(self, f"{name}_bias")
        return layer_norm(h, weight.shape, weight, bias, NORM_EPSILON).to(self.precision)


def _largest_key(qkv: torch.Tensor) -> torch.Tensor:
    keys = qkv.view(len(qkv), 3, -1)[:, 1]
    largest: torch.Tensor = torch.linalg.vector_norm(keys, torch.inf, dtype=torch.float32)
    return largest


def parameter_name(name: str) -> str:
    """Return a block's parameter for a name in the file: the part after the block's number, "_" for "."."""
    return name.removeprefix(f"{BLOCKS}.").split(".", 1)[1].replace(".", "_")


def prepared(name: str, tensor: torch.Tensor) -> torch.Tensor:
    """Return a tensor of the file as a `Block` stores it."""
    # The bias is inside the GELU, so its factor applies.
    return tensor.float() * GELU_SLOPE if name.endswith("mlp.c_fc.b") else tensor

"""The top-level prior, from codes to the residual stream after each block."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.func import functional_call
from torch.nn.functional import layer_norm, scaled_dot_product_attention, silu

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.network.memory import N_SLOTS, padded_length
from dancedata.audio.jukebox.network.tensors import BLOCKS, block_tensors

# Jukebox's GELU is u * sigmoid(1.702 u) = silu(1.702 u) / 1.702. The factors go into the two products around it.
GELU_SLOPE = 1.702
_NORM_EPSILON = 1e-5
#: Patterns of attention, by the number of the block modulo 3.
ROW, COLUMN, PREVIOUS_ROW = range(3)


@dataclass(frozen=True)
class Prior:
    """Tables and blocks, on the device."""

    config: JukeboxConfig
    start: torch.Tensor
    code_table: torch.Tensor
    positions: torch.Tensor
    stream: BlockStream

    def run(self, codes: torch.Tensor) -> Iterator[tuple[int, torch.Tensor, torch.Tensor | None]]:
        """Compute the residual stream, block by block.

        `codes`: (B, T) int64 on the device; shorter clips are padded at their end with any code, which has no effect
            by causality.
        Yields: Layer, from 1; h (B, T, W) float32, a view that the next block changes; in fp16 the largest key yet.
        """
        n_clips, n_codes = codes.shape
        h = self._embed(codes)
        largest: torch.Tensor | None = None
        for layer, key in self.stream.run(h.view(-1, self.config.width), n_clips):
            largest = key if largest is None or key is None else torch.maximum(largest, key)
            yield layer, h[:, :n_codes], largest

    def _embed(self, codes: torch.Tensor) -> torch.Tensor:
        """Return the input (B, L, W) of the first block, L whole rows: each position has the previous code."""
        n_clips, n_codes = codes.shape
        length = padded_length(self.config, n_codes)
        before = codes.new_zeros(n_clips, length)
        before[:, 1:n_codes] = codes[:, :-1]
        h = self.code_table[before]
        h[:, 0] = self.start
        return h.add_(self.positions[:length])


class BlockStream:
    """The blocks, and device memory for two of those on the host.

    The weights of a block are copied while the previous block computes. Accelerate's offloading copies at the moment
    of use, from memory that is not pinned, so that the device waits for every block.

    `blocks`: Weights of resident ones are on `device`, those of the others on the host (pinned for CUDA).
    """

    def __init__(self, blocks: Sequence[Block], resident: Sequence[bool], device: torch.device) -> None:
        self.blocks = blocks
        self.resident = resident
        self._away = [index for index, is_resident in enumerate(resident) if not is_resident]
        homes = [dict(blocks[index].named_parameters()) for index in self._away[:N_SLOTS]]
        self._slots = [_Slot(home, device) for home in homes]
        self._copies: torch.cuda.Stream | None = None
        if device.type == "cuda" and self._away:
            self._copies = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]

    def run(self, h: torch.Tensor, n_clips: int) -> Iterator[tuple[int, torch.Tensor | None]]:
        """Send the residual stream h (n_clips * L, W) through all blocks, in place; yield what each returns."""
        queue = iter(self._away)
        for slot, index in zip(self._slots, queue, strict=False):
            self._fetch(slot, index)
        turn = 0
        for index, block in enumerate(self.blocks):
            if self.resident[index]:
                yield index + 1, block(h, n_clips)
                continue
            slot = self._slots[turn % len(self._slots)]
            slot.wait()
            largest = functional_call(block, slot.weights, (h, n_clips))
            slot.release()
            following = next(queue, None)
            if following is not None:
                self._fetch(slot, following)
            turn += 1
            yield index + 1, largest

    def _fetch(self, slot: _Slot, index: int) -> None:
        slot.fill(dict(self.blocks[index].named_parameters()), self._copies)


class _Slot:
    """Device memory for one block, and two events: its weights are copied; no computation uses them any more."""

    def __init__(self, home: Mapping[str, torch.Tensor], device: torch.device) -> None:
        self.weights = {name: torch.empty_like(weight, device=device) for name, weight in home.items()}
        self._device = device
        self._arrived: Any = None
        self._released: Any = None

    def fill(self, home: Mapping[str, torch.Tensor], copies: torch.cuda.Stream | None) -> None:
        """Begin to copy a block's weights from the host."""
        if copies is None:
            self._copy(home)
            return
        with torch.cuda.stream(copies):
            if self._released is not None:
                copies.wait_event(self._released)
            self._copy(home)
            self._arrived = copies.record_event()

    def _copy(self, home: Mapping[str, torch.Tensor]) -> None:
        for name, weight in self.weights.items():
            weight.copy_(home[name], non_blocking=True)

    def wait(self) -> None:
        """Delay the computation until the weights are copied."""
        if self._arrived is not None:
            torch.cuda.current_stream(self._device).wait_event(self._arrived)

    def release(self) -> None:
        """Record that all operations launched so far are the last to use these weights."""
        if self._arrived is not None:
            self._released = torch.cuda.current_stream(self._device).record_event()


class Block(nn.Module):
    """h <- h + a + m; a = attention of norm(h), m = MLP of norm(h + a).

    Its parameters have the names of the file, with "_" for ".": ``attn_c_attn_w`` and so on.

    `index`: From 0; decides the attention pattern.
    `precision`: Type of the factors of matrix products. In fp32, weights keep their stored type, which is exact and
        takes half the memory; biases and norms are fp32.
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

        Returns: In fp16, () float32: the largest key, infinite if keys overflowed. Any other overflow reaches h, but
            a softmax weight of 0 can hide an infinite key. In other types None: their range is that of h.
        """
        qkv = product(self._norm(h, "ln_0"), self.attn_c_attn_w, self.attn_c_attn_b)
        attended = factored_attention(qkv, self.kind, n_clips=n_clips, heads=self.heads, row_length=self.row_length)
        largest = _largest_key(qkv) if self.precision == torch.float16 else None
        del qkv
        _add_product(h, attended, self.attn_c_proj_w, self.attn_c_proj_b)
        del attended
        hidden = product(self._norm(h, "ln_1"), self.mlp_c_fc_w, self.mlp_c_fc_b, alpha=GELU_SLOPE)
        _add_product(h, silu(hidden, inplace=True), self.mlp_c_proj_w, self.mlp_c_proj_b, alpha=1 / GELU_SLOPE)
        return largest

    def _norm(self, h: torch.Tensor, name: str) -> torch.Tensor:
        weight, bias = getattr(self, f"{name}_weight"), getattr(self, f"{name}_bias")
        return layer_norm(h, weight.shape, weight, bias, _NORM_EPSILON).to(self.precision)


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


def factored_attention(qkv: torch.Tensor, kind: int, *, n_clips: int, heads: int, row_length: int) -> torch.Tensor:
    """Attend within the row, within the column, or to the previous row.

    The Sparse Transformer (Child et al. 2019) as Jukebox uses it: rows of 64 codes, and a pattern for every third
    block. The sequence is padded to full rows at its end; by causality, the padding has no effect.

    `qkv`: (n_clips * L, 3 S): queries, keys and values of sequences of L codes, L a multiple of the row length;
        head i has the i-th part of the S columns.
    `kind`: `ROW`, `COLUMN` or `PREVIOUS_ROW`.
    Returns: (n_clips * L, S), same type.
    """
    n_codes, width = qkv.shape[0], qkv.shape[1] // 3
    n_rows = n_codes // n_clips // row_length
    rows = qkv.view(n_clips * n_rows, row_length, 3, heads, width // heads)
    if kind == COLUMN:
        columns = rows.view(n_clips, n_rows, row_length, 3, heads, -1).permute(3, 0, 2, 4, 1, 5)
        q, k, v = columns.reshape(3, n_clips * row_length, heads, n_rows, -1)
        attended = _attend(q, k, v, causal=True).view(n_clips, row_length, heads, n_rows, -1)
        return attended.permute(0, 3, 1, 2, 4).reshape(n_codes, width)
    q, k, v = rows.permute(2, 0, 3, 1, 4)
    if kind == ROW:
        return _attend(q, k, v, causal=True).transpose(1, 2).reshape(n_codes, width)
    attended = qkv.new_zeros(n_clips * n_rows, row_length, heads, width // heads)
    if n_clips * n_rows > 1:
        attended[1:] = _attend(q[1:], k[:-1], v[:-1], causal=False).transpose(1, 2)
    # The first row of a clip has no previous row; above, it attended to the last row of another clip.
    attended[::n_rows] = 0
    return attended.view(n_codes, width)


def _attend(q: torch.Tensor, k: torch.Tensor, v: torch.Tensor, *, causal: bool) -> torch.Tensor:
    """Softmax(q k / sqrt(width)) v of (N, heads, length, width); the softmax in fp32.

    The kernels scale before or within the product of q and k, in fp32; the reference's order, product first, can
    overflow in fp16.
    """
    if q.device.type == "cpu" and q.dtype != torch.float32:
        return scaled_dot_product_attention(q.float(), k.float(), v.float(), is_causal=causal).to(q.dtype)
    return scaled_dot_product_attention(q, k, v, is_causal=causal)


def product(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *, alpha: float = 1.0) -> torch.Tensor:
    """Linear layer alpha * (x @ weight) + bias of x (N, in), rounded to its type; sums in fp32."""
    if x.device.type == "cpu" and x.dtype != torch.float32:
        # CPUs without half-precision units take 75 times as long. The tensor cores of GPUs compute the same:
        # products of exactly representable factors, summed in fp32 and rounded once.
        return torch.addmm(bias.float(), x.float(), weight.float(), alpha=alpha).to(x.dtype)
    return torch.addmm(bias, x, weight.to(x.dtype), alpha=alpha)


def _add_product(
    total: torch.Tensor, x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *, alpha: float = 1.0
) -> None:
    """Add a linear layer to the fp32 residual stream `total` (N, out), in place; otherwise as `product`."""
    if x.dtype == torch.float32:
        total.addmm_(x, weight.float(), alpha=alpha).add_(bias)
    else:
        total.add_(product(x, weight, bias, alpha=alpha))

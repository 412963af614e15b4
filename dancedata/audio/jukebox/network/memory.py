"""Device memory by accounting, and the choice of the blocks that stay on the host."""

import math
from dataclasses import dataclass

import torch

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.network.tensors import TensorSpec, block_tensors, vqvae_tensors
from dancedata.core.errors import UsageError

# Blocks on the host are copied into these on the device: one is in use while the other is filled.
N_SLOTS = 2
MAX_BATCH = 32


@dataclass(frozen=True)
class Placement:
    """Which blocks are on the device, and the bytes of weights there."""

    resident: tuple[bool, ...]
    weight_bytes: int


def padded_length(config: JukeboxConfig, n_codes: int) -> int:
    """Round a number of codes up to whole rows of the factored attention."""
    return math.ceil(n_codes / config.row_length) * config.row_length


def kept_bytes(spec: TensorSpec, precision: torch.dtype) -> int:
    """Size of a block's tensor in `transformer.Block`."""
    stored = 2 if spec.name.endswith(".w") else 4
    half = precision != torch.float32 and spec.name.endswith((".w", ".b"))
    return math.prod(spec.shape) * (2 if half else stored)


def block_bytes(config: JukeboxConfig, precision: torch.dtype) -> int:
    """Size of one block: 138 MB at 5b."""
    return sum(kept_bytes(spec, precision) for spec in block_tensors(config, 0))


def fixed_bytes(config: JukeboxConfig, precision: torch.dtype, max_codes: int) -> int:
    """Size of the tensors that are always on the device: VQ-VAE, tables; in fp32 also one weight cast from fp16."""
    vqvae = sum(spec.needed_bytes for spec in vqvae_tensors(config))
    rows = config.codebook_size + padded_length(config, max_codes) + 1
    largest = max(math.prod(spec.shape) for spec in block_tensors(config, 0))
    return vqvae + 4 * rows * config.width + (4 * largest if precision == torch.float32 else 0)


def clip_bytes(config: JukeboxConfig, precision: torch.dtype, n_codes: int) -> int:
    """Size of one clip's activations at their peak."""
    codes = padded_length(config, n_codes)
    # In a block: the residual stream, its norm and the half-precision copy of the norm; in fp32 the stream, the norm
    # and the MLP's hidden layer. In the encoder: three tensors at half the sample rate.
    peak_columns = 10 * config.width if precision != torch.float32 else 8 * config.width + 4 * config.mlp_width
    encoder = 3 * 4 * config.conv_width * n_codes * config.hop // 2
    return max(codes * peak_columns, encoder)


def place(
    config: JukeboxConfig, n_blocks: int, precision: torch.dtype, max_codes: int, budget: int | None
) -> Placement:
    """Decide which blocks stay on the device, with memory left for a clip of `max_codes` codes."""
    block, fixed = block_bytes(config, precision), fixed_bytes(config, precision, max_codes)
    one_clip = clip_bytes(config, precision, max_codes)
    if budget is None or fixed + one_clip + n_blocks * block <= budget:
        return Placement((True,) * n_blocks, fixed + n_blocks * block)
    n_resident = (budget - fixed - one_clip) // block - N_SLOTS
    if n_resident < 0:
        raise UsageError("jukebox: too little device memory, even with all blocks on the host",
                         found=f"{budget / 1e9:.2f} GB",
                         allowed=f"at least {(fixed + one_clip + N_SLOTS * block) / 1e9:.2f} GB",
                         fix="lower max_codes (a 5-s clip has 1722 codes), or compute on the CPU")  # fmt: skip
    # Spread evenly: the next of the other blocks is copied while resident blocks compute.
    n_away = n_blocks - n_resident
    away = {(2 * i + 1) * n_blocks // (2 * n_away) for i in range(n_away)}
    resident = tuple(index not in away for index in range(n_blocks))
    return Placement(resident, fixed + (n_resident + N_SLOTS) * block)


def batch_size(config: JukeboxConfig, precision: torch.dtype, n_codes: int, free: int | None) -> int:
    """Return the number of clips of `n_codes` codes to compute at once."""
    if free is None:
        return 1
    return max(1, min(MAX_BATCH, free // clip_bytes(config, precision, n_codes)))

"""The tensors of OpenAI's two checkpoint files: names, shapes, types, and the rows of each that are needed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.jukebox.config import JukeboxConfig

if TYPE_CHECKING:
    import torch

ENCODER = "encoders.2.level_blocks"
CODEBOOK = "bottleneck.level_blocks.2.k"
BLOCKS = "prior.transformer._attn_mods"
GENRES = "y_emb.bow_genre_emb.emb.weight"
ARTISTS = "y_emb.artist_emb.emb.weight"
SONG_LENGTH = "y_emb.total_length_emb.emb.weight"
SONG_POSITION = "y_emb.absolute_pos_emb.emb.weight"
RELATIVE_POSITION = "y_emb.relative_pos_emb.emb.weight"
CODES = "prior.x_emb.weight"
POSITIONS = "prior.pos_emb.pos_emb"
# The output layer of the prior: in the file, but not needed.
OUTPUT = "prior.x_out.weight"


@dataclass(frozen=True)
class TensorSpec:
    """One tensor of a checkpoint, of which the first `rows` are needed."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    rows: int

    @property
    def needed_shape(self) -> tuple[int, ...]:
        """Shape of the needed rows."""
        return (self.rows, *self.shape[1:])

    @property
    def needed_bytes(self) -> int:
        """Size of the needed rows as stored."""
        return math.prod(self.needed_shape) * (2 if self.dtype == "float16" else 4)


def _spec(name: str, *shape: int, dtype: str = "float32", rows: int | None = None) -> TensorSpec:
    return TensorSpec(name, shape, dtype, shape[0] if rows is None else rows)


def vqvae_tensors(config: JukeboxConfig) -> tuple[TensorSpec, ...]:
    """Return the tensors of vqvae.pth.tar that the level-2 encoder and its codebook need."""
    return (*_encoder_tensors(config), _spec(CODEBOOK, config.codebook_size, config.code_width))


def _encoder_tensors(config: JukeboxConfig) -> Iterator[TensorSpec]:
    width = config.conv_width
    for level, steps in enumerate(config.downs):
        block = f"{ENCODER}.{level}.model"
        for step in range(steps):
            channels = width if step else config.code_width if level else 1
            yield _spec(f"{block}.{step}.0.weight", width, channels, 4)
            yield _spec(f"{block}.{step}.0.bias", width)
            for unit in range(config.conv_depth):
                for layer, kernel in ((1, 3), (3, 1)):
                    yield _spec(f"{block}.{step}.1.model.{unit}.model.{layer}.weight", width, width, kernel)
                    yield _spec(f"{block}.{step}.1.model.{unit}.model.{layer}.bias", width)
        yield _spec(f"{block}.{steps}.weight", config.code_width, width, 3)
        yield _spec(f"{block}.{steps}.bias", config.code_width)


def block_tensors(config: JukeboxConfig, index: int) -> tuple[TensorSpec, ...]:
    """Return all 12 tensors of block `index` (from 0); linear weights are (in, out)."""
    width, attn, mlp = config.width, config.attn_width, config.mlp_width
    prefix = f"{BLOCKS}.{index}"

    def linear(name: str, n_in: int, n_out: int) -> tuple[TensorSpec, TensorSpec]:
        return (_spec(f"{prefix}.{name}.w", n_in, n_out, dtype="float16"), _spec(f"{prefix}.{name}.b", n_out))

    return (
        _spec(f"{prefix}.ln_0.weight", width),
        _spec(f"{prefix}.ln_0.bias", width),
        *linear("attn.c_attn", width, 3 * attn),
        *linear("attn.c_proj", attn, width),
        _spec(f"{prefix}.ln_1.weight", width),
        _spec(f"{prefix}.ln_1.bias", width),
        *linear("mlp.c_fc", width, mlp),
        *linear("mlp.c_proj", mlp, width),
    )


def table_tensors(config: JukeboxConfig, n_codes: int) -> tuple[TensorSpec, ...]:
    """Return all 7 embedding tables, with the rows that sequences of up to `n_codes` codes look up."""
    width, bins = config.width, config.time_bins
    # Every clip is labelled artist 0, genre 0, and begins at time 0.
    return (
        _spec(GENRES, config.n_genres, width, rows=1),
        _spec(ARTISTS, config.n_artists, width, rows=1),
        _spec(SONG_LENGTH, bins, width),
        _spec(SONG_POSITION, bins, width, rows=int(_song_position_bins(config, n_codes).max()) + 1),
        _spec(RELATIVE_POSITION, bins, width, rows=int(_relative_bins(config, n_codes).max()) + 1),
        _spec(CODES, config.codebook_size, width),
        _spec(POSITIONS, config.n_ctx, width, rows=n_codes),
    )


def prior_tensors(config: JukeboxConfig, layer: int, n_codes: int | None = None) -> tuple[TensorSpec, ...]:
    """Return the tensors of prior_level_2.pth.tar that activations up to `layer` (1 to depth) need."""
    blocks = (spec for index in range(layer) for spec in block_tensors(config, index))
    return (*table_tensors(config, config.n_ctx if n_codes is None else n_codes), *blocks)


def all_prior_names(config: JukeboxConfig) -> frozenset[str]:
    """Return all names of the tensors of a prior of this config; a file with others belongs to another network."""
    return frozenset(spec.name for spec in prior_tensors(config, config.depth)) | {OUTPUT}


# The rows of the label tables that clips look up: the same for every clip, as all begin at time 0. A label v in
# [low, high) falls into bin floor(bins * (v - low) / (high - low)).


def _song_length_bin(config: JukeboxConfig) -> int:
    """Return the bin of the song's labelled length, on [min, max) duration."""
    low, high = config.min_duration_s * config.sample_rate, config.max_duration_s * config.sample_rate
    return int(config.time_bins * (config.total_length - low) / (high - low))


def _song_position_bins(config: JukeboxConfig, n_codes: int) -> NDArray[np.int64]:
    """(n_codes,) bins of each code's time since the start of the song, on [0, max duration)."""
    samples = np.arange(n_codes, dtype=np.int64) * config.hop
    bins: NDArray[np.int64] = (config.time_bins * samples / (config.max_duration_s * config.sample_rate)).astype(
        np.int64
    )
    return bins


def _relative_bins(config: JukeboxConfig, n_codes: int) -> NDArray[np.int64]:
    """(n_codes,) bins of each code's time as a part of the song, on [0, 1)."""
    samples = np.arange(n_codes, dtype=np.int64) * config.hop
    bins: NDArray[np.int64] = (config.time_bins * samples / config.total_length).astype(np.int64)
    return bins


def start_vector(genres: torch.Tensor, artists: torch.Tensor) -> torch.Tensor:
    """y_cond, (W,): genre 0 plus artist 0 ("unknown"); the transformer's input before the first code."""
    return genres[0] + artists[0]


def time_conditioning(
    config: JukeboxConfig,
    song_length: torch.Tensor,
    song_position: torch.Tensor,
    relative_position: torch.Tensor,
    n_codes: int,
) -> torch.Tensor:
    """x_cond, (n_codes, W) float32: the three time labels of each position, added."""
    import torch

    at_position = torch.from_numpy(_song_position_bins(config, n_codes))
    at_relative = torch.from_numpy(_relative_bins(config, n_codes))
    # In place: one table of n_codes rows at a time.
    x_cond = song_length[_song_length_bin(config)] + song_position[at_position]
    return x_cond.add_(relative_position[at_relative])

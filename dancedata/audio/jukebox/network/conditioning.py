"""The rows of the label tables that clips look up: the same for every clip, as all begin at time 0.

A label v in [low, high) falls into bin floor(bins * (v - low) / (high - low)).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

    from dancedata.audio.jukebox.config import JukeboxConfig


def song_length_bin(config: JukeboxConfig) -> int:
    """Return the bin of the song's labelled length, on [min, max) duration."""
    low, high = config.min_duration_s * config.sample_rate, config.max_duration_s * config.sample_rate
    return int(config.time_bins * (config.total_length - low) / (high - low))


def song_position_bins(config: JukeboxConfig, n_codes: int) -> NDArray[np.int64]:
    """(n_codes,) bins of each code's time since the start of the song, on [0, max duration)."""
    samples = np.arange(n_codes, dtype=np.int64) * config.hop
    bins: NDArray[np.int64] = (config.time_bins * samples / (config.max_duration_s * config.sample_rate)).astype(
        np.int64
    )
    return bins


def relative_bins(config: JukeboxConfig, n_codes: int) -> NDArray[np.int64]:
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
    """x_cond, (n_codes, W) float32: the three time labels of each position, added.

    Parameters
    ----------
    song_length, song_position, relative_position
        (bins, W) float32 tables, at least as many rows as the bins of `n_codes` codes need.
    """
    import torch

    at_position = torch.from_numpy(song_position_bins(config, n_codes))
    at_relative = torch.from_numpy(relative_bins(config, n_codes))
    # In place: one table of n_codes rows at a time.
    x_cond = song_length[song_length_bin(config)] + song_position[at_position]
    return x_cond.add_(relative_position[at_relative])

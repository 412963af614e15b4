"""The top-level prior, from codes to the residual stream after each block."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.network.block_stream import BlockStream
from dancedata.audio.jukebox.network.memory import padded_length


@dataclass(frozen=True)
class Prior:
    """Tables and blocks, on the device.

    Attributes
    ----------
    config : sizes.
    start : (W,) float32: y_cond, the input before the first code.
    code_table : (codebook_size, W) float32.
    positions : (n, W) float32: position embedding plus x_cond of the first n positions, n whole rows.
    stream : the blocks.
    """

    config: JukeboxConfig
    start: torch.Tensor
    code_table: torch.Tensor
    positions: torch.Tensor
    stream: BlockStream

    def run(self, codes: torch.Tensor) -> Iterator[tuple[int, torch.Tensor, torch.Tensor | None]]:
        """Compute the residual stream, block by block.

        Parameters
        ----------
        codes
            (B, T) int64 on the device; shorter clips are padded at their end with any code, which has no effect by
            causality.

        Yields
        ------
        layer, h, largest_key : tuple
            Layer from 1; h (B, T, W) float32, a view that the next block changes; the largest key so far in fp16.
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

"""Running the blocks in order: those on the device, and those that are copied from the host when needed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
from torch.func import functional_call

from dancedata.audio.jukebox.network.memory import N_SLOTS
from dancedata.audio.jukebox.network.transformer import Block


class BlockStream:
    """The blocks, and device memory for two of those on the host.

    The weights of a block are copied while the previous block computes. Accelerate's offloading copies at the moment
    of use, from memory that is not pinned, so that the device waits for every block.

    Parameters
    ----------
    blocks
        In order; the weights of resident blocks are on `device`, those of the others on the host (pinned for CUDA).
    resident
        For each block, whether it is on the device.
    device
        The device to compute on.
    """

    def __init__(self, blocks: Sequence[Block], resident: Sequence[bool], device: torch.device) -> None:
        self.blocks = blocks
        self.resident = resident
        self._away = [index for index, here in enumerate(resident) if not here]
        homes = [dict(blocks[index].named_parameters()) for index in self._away[:N_SLOTS]]
        self._slots = [_Slot(home, device) for home in homes]
        self._copies: torch.cuda.Stream | None = None
        if device.type == "cuda" and self._away:
            self._copies = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]

    def run(self, h: torch.Tensor, n_clips: int) -> Iterator[tuple[int, torch.Tensor | None]]:
        """Send the residual stream h (n_clips * L, W) through all blocks, in place.

        Yields
        ------
        layer, largest_key : tuple
            After each block: its number from 1, and the result of `Block.forward`.
        """
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

"""A network on a device; what does not fit there stays on the host, by Accelerate."""

from __future__ import annotations

from typing import Any

import torch

from dancedata.audio.networks.devices import free_memory

#: Of the free memory of a card, what weights may take: the rest is for a chunk's activations.
_FOR_WEIGHTS = 0.6


def place(network: Any, device: torch.device, budget: int | None = None) -> Any:
    """Put a network on a device.

    Parameters
    ----------
    budget
        Bytes that its weights may take there; None: 60 % of a card's free memory, all of a CPU's.

    Notes
    -----
    What is beyond the budget stays on the host, and is copied to the device block by block when it is needed.
    """
    if budget is None and device.type == "cuda":
        free = free_memory(device)
        budget = None if free is None else int(_FOR_WEIGHTS * free)
    if budget is None or weight_bytes(network) <= budget:
        return network.to(device)
    from accelerate import (  # type: ignore[import-untyped]
        cpu_offload,
        dispatch_model,
        infer_auto_device_map,
    )

    if device.type == "cpu":
        return cpu_offload(network, execution_device=device)
    whole = getattr(network, "_no_split_modules", None) or []
    where = infer_auto_device_map(
        network,
        max_memory={device.index or 0: budget, "cpu": 1 << 60},
        no_split_module_classes=list(whole),
    )
    return dispatch_model(network, device_map=where, main_device=device)


def weight_bytes(network: torch.nn.Module) -> int:
    """Return the size of all parameters and buffers."""
    return sum(t.numel() * t.element_size() for t in (*network.parameters(), *network.buffers()))

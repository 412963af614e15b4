"""Activations of a network's blocks, captured while it runs: no more of them are kept than are asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import torch


def last_hidden_state(network: Any, inputs: torch.Tensor) -> Callable[[], torch.Tensor]:
    """Return what runs a network of transformers over a batch, for `hidden_states`."""

    def run() -> torch.Tensor:
        last: torch.Tensor = network(inputs).last_hidden_state
        return last

    return run


def hidden_states(
    run: Callable[[], torch.Tensor], blocks: Sequence[torch.nn.Module], layers: Sequence[int], n_layers: int
) -> dict[int, torch.Tensor]:
    """Run a network, and return the layers that are asked for.

    Layer 0 is what enters the first block, layer k what leaves block k, and layer `n_layers` what `run` returns: the
    network's last hidden state, after a final norm where it has one.

    Parameters
    ----------
    run
        Calls the network.
    blocks
        Its blocks up to the highest layer.

    Notes
    -----
    Captured here, as what ``output_hidden_states`` returns last differs between versions of transformers.
    """
    found: dict[int, torch.Tensor] = {}

    def before(_module: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        found[0] = args[0] if args else kwargs["hidden_states"]

    def after(layer: int) -> Callable[..., None]:
        def keep(_module: Any, _args: Any, output: Any) -> None:
            found[layer] = output[0] if isinstance(output, tuple) else output

        return keep

    with ExitStack() as hooks:
        for layer in set(layers) - {n_layers}:
            if layer == 0:
                hooks.callback(blocks[0].register_forward_pre_hook(before, with_kwargs=True).remove)
            else:
                hooks.callback(blocks[layer - 1].register_forward_hook(after(layer)).remove)
        last = run()
    if n_layers in layers:
        found[n_layers] = last
    return found

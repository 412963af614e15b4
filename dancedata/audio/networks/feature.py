"""How a feature runs its network: on which device, with which threads, loaded once, its rows as they are stored."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DataError
from dancedata.core.packages import require

N = TypeVar("N")


def cards_of(device: str) -> list[str]:
    """Return the cards that a feature's key `device` names: every one for "auto"; empty on a CPU."""
    if device != "auto":
        return [device] if device.startswith("cuda") else []
    require("torch", what="a network")
    import torch

    return [f"cuda:{k}" for k in range(torch.cuda.device_count())]


def device_of_process(device: str) -> str:
    """Return the device that this process computes on: for "auto" a card of its own, or else the CPU."""
    if device != "auto":
        return device
    from dancedata.audio.networks.devices import claimed

    return claimed(tuple(cards_of(device))) or "cpu"


def all_cores(device: str) -> AbstractContextManager[Any]:
    """Use all cores on a CPU within the context: a build runs one process of such a feature there."""
    if cards_of(device):
        return nullcontext()
    from loky import cpu_count
    from threadpoolctl import threadpool_limits

    # The cores that this process may use: a batch system assigns a part of the machine.
    limits: AbstractContextManager[Any] = threadpool_limits(limits=cpu_count())
    return limits


def held(networks: dict[Any, N], key: Hashable, load: Callable[[], N]) -> N:
    """Return the network of `key`, which is loaded once; the previous one is released first.

    Few devices have memory for two.
    """
    if key not in networks:
        networks.clear()
        networks[key] = load()
    return networks[key]


def stored(
    feature: str, rows: npt.NDArray[np.float32], dtype: Literal["float16", "float32"], fix: str
) -> npt.NDArray[Any]:
    """Return rows in the type that they are stored in; DataError "overflow" where it cannot hold them.

    Parameters
    ----------
    fix
        What to do about it.
    """
    largest = float(np.abs(rows).max(initial=0))
    if not largest <= float(np.finfo(dtype).max):
        raise DataError(
            f"{feature}: an activation exceeds the range of {dtype}", reason="overflow", found=largest, fix=fix
        )
    return rows.astype(dtype, copy=False)

"""Readers: built datasets as torch datasets and samplers.

The names below are loaded when they are first used, so that importing this package does not import torch.
Without torch, numpy reading is `dancedata.open`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dancedata.readers.batch_loader import BatchLoader
    from dancedata.readers.sampler import EpochSampler
    from dancedata.readers.windows import WindowDataset

__all__ = ["BatchLoader", "EpochSampler", "WindowDataset"]

_HOMES = {
    "BatchLoader": "dancedata.readers.batch_loader",
    "EpochSampler": "dancedata.readers.sampler",
    "WindowDataset": "dancedata.readers.windows",
}


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    try:
        module = import_module(home)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != "torch":
            raise
        raise ImportError(
            f"{__name__}.{name} needs torch, which is not installed here: pip install 'dancedata[torch]'. "
            "Reading with numpy alone is dancedata.open(path)."
        ) from error
    return getattr(module, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

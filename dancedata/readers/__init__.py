"""Readers: built datasets as torch datasets and samplers.

The names below are loaded when they are first used, so that importing this package does not import torch.
Without torch, numpy reading is `dancedata.open`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dancedata.core.lazy import lazy_names

__all__ = ["BatchLoader", "EpochSampler", "WindowDataset"]

if TYPE_CHECKING:
    from dancedata.readers.batch_loader import BatchLoader
    from dancedata.readers.sampler import EpochSampler
    from dancedata.readers.windows import WindowDataset
else:  # type checkers take the imports above, and so find misspelt names
    _get, __dir__ = lazy_names(
        __name__,
        {
            "BatchLoader": "dancedata.readers.batch_loader",
            "EpochSampler": "dancedata.readers.sampler",
            "WindowDataset": "dancedata.readers.windows",
        },
    )

    def __getattr__(name: str) -> Any:
        try:
            return _get(name)
        except ModuleNotFoundError as error:
            if error.name is None or error.name.split(".")[0] != "torch":
                raise
            raise ImportError(
                f"{__name__}.{name} needs torch, which is not installed here: pip install 'dancedata[torch]'. "
                "Reading with numpy alone is dancedata.open(path)."
            ) from error

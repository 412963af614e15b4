"""Readers: built datasets as torch datasets and samplers.

The names below are imported on first use, so that importing this package does not import torch. `dancedata.open`
reads with numpy alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = ["BatchLoader", "EpochSampler", "WindowDataset"]

if TYPE_CHECKING:
    from dancedata.readers.batch_loader import BatchLoader
    from dancedata.readers.sampler import EpochSampler
    from dancedata.readers.windows import WindowDataset
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "BatchLoader": "dancedata.readers.batch_loader",
            "EpochSampler": "dancedata.readers.sampler",
            "WindowDataset": "dancedata.readers.windows",
        },
        without_torch="Reading with numpy alone is dancedata.open(path).",
    )

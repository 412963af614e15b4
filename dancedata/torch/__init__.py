"""Built datasets as torch datasets, samplers and loaders. Kinematics in torch.

The names below are imported on first use, so that importing this package does not import torch. `dancedata.open`
reads with numpy alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = [
    "PRESETS",
    "BalancedSampler",
    "BatchLoader",
    "BatchStream",
    "BucketSampler",
    "ClipDataset",
    "Dancers",
    "EpochSampler",
    "GroupDataset",
    "Mix",
    "Primitives",
    "Relative",
    "Scale",
    "Segments",
    "Select",
    "Text",
    "WindowDataset",
    "Windows",
    "from_plain",
    "pad_clips",
    "to_plain",
]

if TYPE_CHECKING:
    from dancedata.torch.balanced import BalancedSampler
    from dancedata.torch.batch_loader import BatchLoader
    from dancedata.torch.batch_stream import BatchStream
    from dancedata.torch.buckets import BucketSampler
    from dancedata.torch.clip_collate import pad_clips
    from dancedata.torch.clips import ClipDataset
    from dancedata.torch.groups import GroupDataset
    from dancedata.torch.mix import Mix
    from dancedata.torch.options import (
        Dancers,
        Primitives,
        Relative,
        Scale,
        Segments,
        Select,
        Text,
        Windows,
    )
    from dancedata.torch.plain import PRESETS, from_plain, to_plain
    from dancedata.torch.sampler import EpochSampler
    from dancedata.torch.windows import WindowDataset
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "torch.balanced": "BalancedSampler",
            "torch.batch_loader": "BatchLoader",
            "torch.batch_stream": "BatchStream",
            "torch.buckets": "BucketSampler",
            "torch.clip_collate": "pad_clips",
            "torch.clips": "ClipDataset",
            "torch.groups": "GroupDataset",
            "torch.mix": "Mix",
            "torch.options": "Dancers Primitives Relative Scale Segments Select Text Windows",
            "torch.plain": "PRESETS from_plain to_plain",
            "torch.sampler": "EpochSampler",
            "torch.windows": "WindowDataset",
        },
        extra="torch",
        instead="Reading with numpy alone is dancedata.open(path).",
    )

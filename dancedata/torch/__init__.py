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
    "pack_clips",
    "pad_clips",
    "to_plain",
]

if TYPE_CHECKING:
    from dancedata.torch.balanced import BalancedSampler
    from dancedata.torch.batch_loader import BatchLoader
    from dancedata.torch.batch_stream import BatchStream
    from dancedata.torch.buckets import BucketSampler
    from dancedata.torch.clip_collate import pack_clips, pad_clips
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
            "BalancedSampler": "dancedata.torch.balanced",
            "BatchLoader": "dancedata.torch.batch_loader",
            "BatchStream": "dancedata.torch.batch_stream",
            "BucketSampler": "dancedata.torch.buckets",
            "ClipDataset": "dancedata.torch.clips",
            "EpochSampler": "dancedata.torch.sampler",
            "GroupDataset": "dancedata.torch.groups",
            "Mix": "dancedata.torch.mix",
            "Dancers": "dancedata.torch.options",
            "PRESETS": "dancedata.torch.plain",
            "Primitives": "dancedata.torch.options",
            "Relative": "dancedata.torch.options",
            "Scale": "dancedata.torch.options",
            "Segments": "dancedata.torch.options",
            "Select": "dancedata.torch.options",
            "Text": "dancedata.torch.options",
            "Windows": "dancedata.torch.options",
            "from_plain": "dancedata.torch.plain",
            "to_plain": "dancedata.torch.plain",
            "WindowDataset": "dancedata.torch.windows",
            "pack_clips": "dancedata.torch.clip_collate",
            "pad_clips": "dancedata.torch.clip_collate",
        },
        extra="torch",
        instead="Reading with numpy alone is dancedata.open(path).",
    )

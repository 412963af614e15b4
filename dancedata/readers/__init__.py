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
    from dancedata.readers.balanced import BalancedSampler
    from dancedata.readers.batch_loader import BatchLoader
    from dancedata.readers.batch_stream import BatchStream
    from dancedata.readers.buckets import BucketSampler
    from dancedata.readers.clip_collate import pack_clips, pad_clips
    from dancedata.readers.clips import ClipDataset
    from dancedata.readers.groups import GroupDataset
    from dancedata.readers.mix import Mix
    from dancedata.readers.options import (
        PRESETS,
        Dancers,
        Primitives,
        Relative,
        Scale,
        Segments,
        Select,
        Text,
        Windows,
        from_plain,
        to_plain,
    )
    from dancedata.readers.sampler import EpochSampler
    from dancedata.readers.windows import WindowDataset
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "BalancedSampler": "dancedata.readers.balanced",
            "BatchLoader": "dancedata.readers.batch_loader",
            "BatchStream": "dancedata.readers.batch_stream",
            "BucketSampler": "dancedata.readers.buckets",
            "ClipDataset": "dancedata.readers.clips",
            "EpochSampler": "dancedata.readers.sampler",
            "GroupDataset": "dancedata.readers.groups",
            "Mix": "dancedata.readers.mix",
            "Dancers": "dancedata.readers.options",
            "PRESETS": "dancedata.readers.options",
            "Primitives": "dancedata.readers.options",
            "Relative": "dancedata.readers.options",
            "Scale": "dancedata.readers.options",
            "Segments": "dancedata.readers.options",
            "Select": "dancedata.readers.options",
            "Text": "dancedata.readers.options",
            "Windows": "dancedata.readers.options",
            "from_plain": "dancedata.readers.options",
            "to_plain": "dancedata.readers.options",
            "WindowDataset": "dancedata.readers.windows",
            "pack_clips": "dancedata.readers.clip_collate",
            "pad_clips": "dancedata.readers.clip_collate",
        },
        extra="torch",
        instead="Reading with numpy alone is dancedata.open(path).",
    )

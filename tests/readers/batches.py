"""Datasets in all modes, and batches that are compared bit by bit."""

from collections.abc import Mapping
from typing import Any

import torch

from dancedata.readers import WindowDataset
from dancedata.store.dataset import Store

FIELDS = ("lodge139", "fast", "librosa35", "half")
MODES: dict[str, dict[str, Any]] = {
    "plain": {"normalize": False},
    "normalised": {},
    "mirrored and normalised": {"mirror": 0.5, "normalize": FIELDS},
    "relative root": {"fields": ("lodge139",), "relative_root": True, "normalize": False, "mirror": 0.5},
    "unmapped": {"mirror": 0.5, "mapped": False},
    "other windows": {"length_frames": 30, "stride_frames": 7, "mirror": 0.5},
    "primitives": {
        "fields": ("librosa35", "lodge139", "primitives"), "length_frames": 150, "stride_frames": 5,
        "primitive_n": 50, "mirror": 0.5,
    },
    "borders": {"fields": ("lodge139", "primitives"), "primitive_n": 40, "mirror": 0.5},
    "preset": {
        "preset": "lodge-local", "fields": None, "length_frames": 40, "stride_frames": 9, "mirror": 0.5,
        "filter": False,
    },
}  # fmt: skip


def dataset_of(store: Store, mode: str = "mirrored and normalised", **options: Any) -> WindowDataset:
    """Samples as of epoch 0, until a sampler sets another."""
    dataset = WindowDataset(store, **{"fields": FIELDS, "seed": 3, **MODES[mode], **options})
    dataset.set_epoch(0)
    return dataset


def bits(value: Any) -> Any:
    """Something that is equal only where every bit is, with types and the order of keys."""
    if isinstance(value, Mapping):
        return [(name, bits(part)) for name, part in value.items()]
    if isinstance(value, torch.Tensor):
        return str(value.dtype), tuple(value.shape), value.contiguous().numpy().tobytes()
    return value.hex() if isinstance(value, float) else value


def assert_equal(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    assert list(found) == list(wanted)
    for name, value in wanted.items():
        assert bits(found[name]) == bits(value), name

"""Datasets in all modes, and batches that are compared bit by bit."""

from collections.abc import Mapping
from typing import Any

import torch

import dancedata
from dancedata.store.dataset import Store
from dancedata.torch import PRESETS, Primitives, Relative, Scale, Select, WindowDataset, Windows

FIELDS = ("lodge139", "fast", "librosa35", "half")
MODES: dict[str, dict[str, Any]] = {
    "plain": {"scale": None},
    "normalised": {},
    "mirrored and normalised": {"augment": {"mirror": 0.5}, "scale": Scale(fields=FIELDS)},
    "relative root": {"fields": (Relative("lodge139"),), "scale": None, "augment": {"mirror": 0.5}},
    "unmapped": {"augment": {"mirror": 0.5}},
    "other windows": {"windows": Windows(length=30, stride=7), "augment": {"mirror": 0.5}},
    "primitives": {
        "fields": ("librosa35", "lodge139", Primitives(n=50)), "windows": Windows(length=150, stride=5),
        "augment": {"mirror": 0.5},
    },
    "borders": {"fields": ("lodge139", Primitives(n=40)), "augment": {"mirror": 0.5}},
    "preset": PRESETS["lodge-local"] | {
        "windows": Windows(length=40, stride=9, trim=True), "select": Select(), "scale": Scale(),
        "augment": {"mirror": 0.5},
    },
}  # fmt: skip


def dataset_of(store: Store, mode: str = "mirrored and normalised", **options: Any) -> WindowDataset:
    """Samples as of epoch 0, until a sampler sets another."""
    store = dancedata.open(store.path, mapped=False) if mode == "unmapped" else store
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

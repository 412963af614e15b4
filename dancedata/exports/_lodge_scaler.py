"""Lodge's Normalizer.pth, written without Lodge's code."""

from __future__ import annotations

import io
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.store.normalize import CONSTANT_RANGE

_MODULE = "dld.data.utils.preprocess"
_one_at_a_time = threading.Lock()


def normalizer_bytes(pieces: Iterable[npt.NDArray[np.float32]]) -> bytes:
    """Return a pickle of torch of Lodge's class ``Normalizer``, min-max to [-1, 1], fitted on rows (T, D) of pieces.

    Its attribute ``scaler`` has those of Lodge's ``MinMaxScaler``, float32 as Lodge computes them. Where
    `torch.load` reads it, the module ``dld.data.utils.preprocess`` of Lodge has to be importable.
    """
    import torch

    low, high, n_rows = _extremes(pieces)
    spread = high - low
    scale = np.float32(2) / np.where(spread < np.float32(CONSTANT_RANGE), np.float32(1), spread)
    arrays = {
        "scale_": scale,
        "min_": np.float32(-1) - low * scale,
        "data_min_": low,
        "data_max_": high,
        "data_range_": spread,
    }
    tensors = {name: torch.from_numpy(array.astype(np.float32)) for name, array in arrays.items()}
    buffer = io.BytesIO()
    with _lodge_classes() as (normalizer, scaler):
        made = scaler()
        made.__dict__.update(
            {"feature_range": (-1, 1), "copy": True, "clip": True, "n_samples_seen_": n_rows, **tensors}
        )
        whole = normalizer()
        whole.__dict__["scaler"] = made
        torch.save(whole, buffer)
    return buffer.getvalue()


def _extremes(pieces: Iterable[npt.NDArray[np.float32]]) -> tuple[Any, Any, int]:
    low = high = None
    n_rows = 0
    for rows in pieces:
        if len(rows):
            n_rows += len(rows)
            low = rows.min(axis=0) if low is None else np.minimum(low, rows.min(axis=0))
            high = rows.max(axis=0) if high is None else np.maximum(high, rows.max(axis=0))
    return low, high, n_rows


@contextmanager
def _lodge_classes() -> Iterator[tuple[type[Any], type[Any]]]:
    """Give two empty classes with the names of Lodge's, under the name of its module, which pickle looks up."""
    names = [".".join(_MODULE.split(".")[:n]) for n in range(1, _MODULE.count(".") + 2)]
    with _one_at_a_time:
        before = {name: sys.modules.get(name) for name in names}
        try:
            for name in names:
                sys.modules[name] = ModuleType(name)
            made = [type(name, (), {"__module__": _MODULE}) for name in ("Normalizer", "MinMaxScaler")]
            for cls in made:
                setattr(sys.modules[_MODULE], cls.__name__, cls)
            yield made[0], made[1]
        finally:
            for name, module in before.items():
                if module is None:
                    sys.modules.pop(name, None)
                else:
                    sys.modules[name] = module

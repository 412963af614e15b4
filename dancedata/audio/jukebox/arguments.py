"""Checks of what an encoder is asked for."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.core.errors import DataError, UsageError


def require_layers(layers: Iterable[int], highest: int) -> tuple[int, ...]:
    """Return the layers as a tuple; UsageError unless each is within 1 .. highest, and asked for once."""
    chosen = tuple(layers)
    good = all(isinstance(layer, int) and 1 <= layer <= highest for layer in chosen)
    if not chosen or not good or len(set(chosen)) < len(chosen):
        raise UsageError(
            "jukebox: these layers cannot be given",
            found=chosen,
            allowed=f"one or more of 1 to {highest}, each once, in any order",
        )
    return chosen


def require_device(device: str | torch.device | None) -> torch.device:
    """Return a device that exists; None is CUDA where there is a card, else the CPU."""
    if device is None:
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        target = torch.device(device)
    except RuntimeError as error:
        raise UsageError("jukebox: unknown device", found=device, allowed="cpu, cuda, cuda:1, ...") from error
    if target.type not in ("cpu", "cuda"):
        raise UsageError(
            "jukebox: it does not compute on such a device", found=device, allowed="cpu, cuda, cuda:1, ..."
        )
    if target.type == "cuda" and (target.index or 0) >= torch.cuda.device_count():
        raise UsageError(
            "jukebox: there is no such device",
            found=str(device),
            allowed=f"cpu, or {torch.cuda.device_count()} cards",
        )
    return target


def require_max_codes(max_codes: int | None, config: JukeboxConfig) -> int:
    """Return the longest clip in codes; None is the whole context."""
    longest = config.n_ctx if max_codes is None else max_codes
    if not 1 <= longest <= config.n_ctx:
        raise UsageError("jukebox: bad max_codes", found=max_codes, allowed=f"1 to {config.n_ctx}")
    return longest


def require_codes(codes: ArrayLike, config: JukeboxConfig) -> NDArray[np.int64]:
    """Return one clip's codes as (n,) int64; UsageError for other arrays, DataError "short_audio" for none."""
    array = np.asarray(codes)
    if array.ndim != 1 or not (np.issubdtype(array.dtype, np.integer) or not array.size):
        raise UsageError(
            "jukebox: these are no codes", found=f"{array.dtype} of shape {array.shape}", allowed="(n,) integers"
        )
    if not array.size:
        raise DataError("jukebox: the clip has no codes", reason="short_audio", found="0 codes")
    if array.min() < 0 or array.max() >= config.codebook_size:
        raise UsageError(
            "jukebox: codes out of range",
            found=f"{array.min()} to {array.max()}",
            allowed=f"0 to {config.codebook_size - 1}",
        )
    return array.astype(np.int64, copy=False)

"""Batches of samples of a model: as arrays, their lengths, their identity, and those of other processes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError
from dancedata.core.text import shown

#: Tolerance of traces of a sample that is generated again: the same network in batches of another size.
_SAME = 1e-4


@dataclass(frozen=True)
class Trace:
    """Numbers by which two samples of one name are compared."""

    motion: npt.NDArray[np.float64]  # (3, D) of the columns: mean, mean weighted by time, and mean square
    frames: int
    beats: tuple[int, ...] | None

    @classmethod
    def of(cls, columns: npt.NDArray[Any], beats: MusicBeats | None) -> Trace:
        """Return the trace of columns (L, D) and of the beats of their music."""
        rows = columns.astype(np.float64)
        weights = np.stack([np.ones(len(rows)), np.linspace(-1, 1, len(rows))]) / max(1, len(rows))
        with np.errstate(all="ignore"):  # columns that cannot be measured are traced as well
            motion = np.concatenate([weights @ rows, weights[:1] @ rows**2])
        return cls(motion, len(rows), None if beats is None else tuple(beats.frames.tolist()))

    def same(self, trace: Trace) -> bool:
        """Whether a trace is of the same sample."""
        return (
            (self.frames, self.beats) == (trace.frames, trace.beats)
            and self.motion.shape == trace.motion.shape
            and bool(np.allclose(self.motion, trace.motion, rtol=_SAME, atol=_SAME, equal_nan=True))
        )


def _torch_distributed() -> Any:
    torch = sys.modules.get("torch")
    distributed = getattr(torch, "distributed", None)
    ready = distributed is not None and distributed.is_available() and distributed.is_initialized()
    return distributed if ready else None


def gather_by_torch(objects: list[Any]) -> list[Any]:
    """Return the objects of all processes of torch.distributed; those of this one without it."""
    distributed = _torch_distributed()
    if distributed is None:
        return objects
    gathered: list[Any] = [None] * distributed.get_world_size()
    distributed.all_gather_object(gathered, objects)
    return [item for items in gathered for item in items]


def sample_lengths(batch: npt.NDArray[Any], names: Sequence[str], lengths: npt.NDArray[Any] | None) -> list[int]:
    """Return the number of rows of each sample of a batch (B, L, D): `lengths` (B,), or L."""
    if lengths is not None:
        if lengths.shape != batch.shape[:1] or not np.isin(lengths, np.arange(1, batch.shape[1] + 1)).all():
            raise UsageError(
                "lengths are not the rows of each sample", found=shown(lengths),
                allowed=f'{len(batch)} whole numbers from 1 to {batch.shape[1]}, as batch["lengths"][FIELD] has them',
            )  # fmt: skip
        return [int(size) for size in lengths]
    for name, rows in zip(names, batch, strict=True):
        even = (rows == rows[:, :1]).all(axis=1)  # all columns are one number: filled up, and no motion
        if len(rows) and even[-1] and not even.all():
            raise UsageError(
                "a sample is padded: its last rows are one number", where=f"sample {name}",
                found=f"{int(even[::-1].argmin())} rows of {rows[-1, 0]:g}",
                fix='give their lengths: update(..., lengths=batch["lengths"][FIELD]), as pad_clips gives them',
            )  # fmt: skip
    return [batch.shape[1]] * len(batch)

"""EDGE's normaliser: min-max to [-1, 1] per column."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Mirror
from dancedata.core.errors import UsageError

#: Columns with a smaller range count as constant: 10 float32 eps, as in scikit-learn and EDGE.
CONSTANT_RANGE = 10 * float(np.finfo(np.float32).eps)


class MinMax:
    """Scale columns to [-1, 1] by their minimum and maximum in training (EDGE, Tseng et al. 2023).

    A column that is constant in training gets a range of 1, so that its value maps to -1.

    Parameters
    ----------
    data_min, data_max
        (D,) minimum and maximum of the training data.
    """

    def __init__(self, data_min: npt.ArrayLike, data_max: npt.ArrayLike) -> None:
        self.data_min = np.asarray(data_min, dtype=np.float64)
        self.data_max = np.asarray(data_max, dtype=np.float64)
        if self.data_min.shape != self.data_max.shape or self.data_min.ndim != 1:
            raise UsageError(
                "a scaler requires one minimum and one maximum per column",
                found=f"shapes {self.data_min.shape} and {self.data_max.shape}",
            )
        # Values of a store are float32; larger bounds would overflow range and scale.
        for bounds in (self.data_min, self.data_max):
            if not (np.abs(bounds) <= np.finfo(np.float32).max).all():
                raise UsageError("a scaler has a bound that is not a finite float32")
        self.data_range = self.data_max - self.data_min
        safe = np.where(self.data_range < CONSTANT_RANGE, 1.0, self.data_range)
        self.scale = 2.0 / safe
        self.offset = -1.0 - self.data_min * self.scale

    @property
    def width(self) -> int:
        """Number of columns D."""
        return len(self.data_min)

    def __repr__(self) -> str:
        """Show the number of columns, and of those constant in training."""
        constant = int((self.data_range < CONSTANT_RANGE).sum())
        return f"MinMax({self.width} columns, {constant} of them constant)"

    def normalize(self, x: Any, clip: bool = True) -> Any:
        """Map x, (..., D) numpy or torch, to [-1, 1]; values outside the range in training are clipped if `clip`."""
        scale, offset = self._like(x)
        y = x * scale + offset
        return y.clip(-1, 1) if clip else y

    def unnormalize(self, x: Any, clip: bool = False) -> Any:
        """Invert `normalize`; with `clip`, x is first clipped to [-1, 1], as EDGE does with generated motion."""
        scale, offset = self._like(x)
        return ((x.clip(-1, 1) if clip else x) - offset) / scale

    def with_mirror(self, mirror: Mirror) -> MinMax:
        """Return the scaler with the joint range of x and mirror(x)."""
        low, high = mirror.apply(self.data_min), mirror.apply(self.data_max)
        return MinMax(
            np.minimum(self.data_min, np.minimum(low, high)), np.maximum(self.data_max, np.maximum(low, high))
        )

    def state_dict(self) -> dict[str, list[float]]:
        """Return the input of `from_state`, as plain JSON data."""
        return {"data_min": self.data_min.tolist(), "data_max": self.data_max.tolist()}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> MinMax:
        """Read the result of `state_dict`."""
        return cls(state["data_min"], state["data_max"])

    def _like(self, x: Any) -> tuple[Any, Any]:
        if x.shape[-1] != self.width:
            raise UsageError("the scaler has a different width", found=f"{x.shape[-1]} columns", allowed=self.width)
        if hasattr(x, "new_tensor"):
            return x.new_tensor(self.scale), x.new_tensor(self.offset)
        dtype = x.dtype if np.issubdtype(x.dtype, np.floating) else np.float64
        return self.scale.astype(dtype), self.offset.astype(dtype)

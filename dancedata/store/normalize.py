"""EDGE's normaliser: min-max to [-1, 1] per column, and its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Mirror
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import json_sha256
from dancedata.core.text import shown
from dancedata.files import atomic
from dancedata.files.strict_json import read_json

#: Columns of float32 with a smaller range count as constant: 10 float32 eps, as in scikit-learn and EDGE.
CONSTANT_RANGE = 10 * float(np.finfo(np.float32).eps)
#: Layout of scaler files, and their keys.
_FORMAT = 1
_KEYS = ("scaler", "field", "columns", "dataset", "dtype", "data_min", "data_max", "sha256")
#: Far above the widest field, 4,800 columns with their names.
_MAX_BYTES = 1 << 24


class _Array(Protocol):
    """A numpy array or a torch tensor."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def clip(self, low: Any, high: Any, /) -> Any: ...


#: Values (..., D) of numpy or torch; results are of the same kind.
Values = TypeVar("Values", bound=_Array)


class MinMax:
    """Scale columns to [-1, 1] by their minimum and maximum in training (EDGE, Tseng et al. 2023).

    A column that is constant in training gets a range of 1, so that its value maps to -1.

    Parameters
    ----------
    data_min, data_max
        (D,) minimum and maximum of the training data.
    dtype
        Type that the data are stored in. Columns of float16 count as constant below 10 of its steps at their
        magnitude, those of float32 below 10 eps, as in EDGE.
    field, columns, dataset
        Name of the field, names of its columns, and the hash of the dataset's own scaler of that field; "" and ()
        where that is unknown.
    """

    def __init__(
        self,
        data_min: npt.ArrayLike,
        data_max: npt.ArrayLike,
        *,
        dtype: npt.DTypeLike = np.float32,
        field: str = "",
        columns: Sequence[str] = (),
        dataset: str = "",
    ) -> None:
        self.data_min = np.asarray(data_min, dtype=np.float64)
        self.data_max = np.asarray(data_max, dtype=np.float64)
        self.dtype, self.field, self.columns, self.dataset = np.dtype(dtype), field, tuple(columns), dataset
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
        safe = np.where(self._constant, 1.0, self.data_range)
        self.scale = 2.0 / safe
        self.offset = -1.0 - self.data_min * self.scale

    @property
    def width(self) -> int:
        """Number of columns D."""
        return len(self.data_min)

    @cached_property
    def sha256(self) -> str:
        """Hash of the numbers, by which checkpoints, exports and pools name the scaler."""
        return json_sha256(self.state_dict())

    @property
    def _constant(self) -> npt.NDArray[np.bool_]:
        least: Any = CONSTANT_RANGE
        if self.dtype == np.float16:
            step = float(np.finfo(np.float16).eps)
            least = np.maximum(least, 10 * step * np.maximum(np.abs(self.data_min), np.abs(self.data_max)))
        return np.asarray(self.data_range < least)

    def __repr__(self) -> str:
        return f"MinMax({self.width} columns, {int(self._constant.sum())} of them constant)"

    def normalize(self, x: Values, clip: bool = False) -> Values:
        """Map x, (..., D) numpy or torch, to [-1, 1].

        Values outside the range in training go beyond, and come back whole; with `clip` they are cut to [-1, 1], as
        EDGE and Lodge do. Arithmetic and result are float32 for half precision (float16, bfloat16), float64 for
        integers, else of x's type.
        """
        values, scale, offset = self._like(x)
        scaled: Values = values * scale + offset
        return scaled.clip(-1, 1) if clip else scaled

    def unnormalize(self, x: Values, clip: bool = False) -> Values:
        """Invert `normalize`, in its types; with `clip`, x is first clipped to [-1, 1], as EDGE does."""
        values, scale, offset = self._like(x)
        unscaled: Values = ((values.clip(-1, 1) if clip else values) - offset) / scale
        return unscaled

    def with_mirror(self, mirror: Mirror) -> MinMax:
        """Return the scaler with the joint range of x and mirror(x)."""
        low, high = mirror.apply(self.data_min), mirror.apply(self.data_max)
        return self.with_range(
            np.minimum(self.data_min, np.minimum(low, high)), np.maximum(self.data_max, np.maximum(low, high))
        )

    def with_range(self, data_min: npt.ArrayLike, data_max: npt.ArrayLike) -> MinMax:
        """Return a scaler of another range, of the same field."""
        return MinMax(
            data_min, data_max, dtype=self.dtype, field=self.field, columns=self.columns, dataset=self.dataset
        )

    def state_dict(self) -> dict[str, Any]:
        """Return the input of `from_state`, as plain JSON data."""
        state: dict[str, Any] = {"data_min": self.data_min.tolist(), "data_max": self.data_max.tolist()}
        return state if self.dtype == np.float32 else {**state, "dtype": self.dtype.name}

    @classmethod
    def from_state(cls, state: Mapping[str, Any], **properties: Any) -> Self:
        """Read the result of `state_dict`; `properties` are further arguments of `MinMax`."""
        return cls(state["data_min"], state["data_max"], **{"dtype": state.get("dtype", np.float32), **properties})

    def save(self, path: str | Path) -> None:
        """Write the scaler to a JSON file, for ``scaler=`` and ``--scaler``, with the field that it is of.

        Raises
        ------
        StoreError
            If it cannot be written.
        """
        values = (_FORMAT, self.field, list(self.columns), self.dataset, self.dtype.name)
        state = dict(zip(_KEYS, (*values, self.data_min.tolist(), self.data_max.tolist(), self.sha256), strict=True))
        try:
            atomic.write_json(Path(path).expanduser(), state)
        except OSError as error:
            raise StoreError("the scaler cannot be written", where=path, found=str(error)) from error

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file of `save`.

        Raises
        ------
        UsageError
            If it cannot be read, is not such a file, or was changed.
        """
        try:
            state = read_json(Path(path).expanduser(), _MAX_BYTES)
            normalizer = cls.from_state(state, **_properties(state))
            if normalizer.sha256 != state["sha256"]:
                raise ValueError("the numbers are not those of its hash")
        except (OSError, ValueError, TypeError, OverflowError, UsageError) as error:
            raise UsageError(
                "not a scaler file", where=path, found=shown(error), allowed="a file of normalizer.save(...)"
            ) from error
        return normalizer

    def require(self, *, field: str, columns: Sequence[str], dataset: str = "") -> Self:
        """Return this scaler if it can be of a field; what is unknown on one side, "" or (), is not compared.

        Raises
        ------
        UsageError
            For another width, field, columns or dataset.
        """
        fix = "give the scaler that training used; to use this one all the same: MinMax(s.data_min, s.data_max)"
        if self.width != len(columns):
            raise UsageError(
                "the scaler has a different width", where=f"field {field}", found=f"{self.width} columns",
                allowed=len(columns), fix=fix,
            )  # fmt: skip
        for property_, actual, expected in (
            ("field", self.field, field),
            ("columns", ", ".join(self.columns), ", ".join(columns)),
            ("dataset", self.dataset, dataset),
        ):
            if actual and expected and actual != expected:
                raise UsageError(
                    f"the scaler is of another {property_}", where=f"field {field}", found=shown(actual), fix=fix
                )
        return self

    def _like(self, x: Any) -> tuple[Any, Any, Any]:
        """Return x in the type of the arithmetic, scale and offset."""
        if x.shape[-1] != self.width:
            raise UsageError("the scaler has a different width", found=f"{x.shape[-1]} columns", allowed=self.width)
        if hasattr(x, "new_tensor"):
            x = x.double() if not x.is_floating_point() else x.float() if x.element_size() < 4 else x
            return x, x.new_tensor(self.scale), x.new_tensor(self.offset)
        dtype = np.promote_types(x.dtype, np.float32) if np.issubdtype(x.dtype, np.floating) else np.dtype(np.float64)
        return x.astype(dtype, copy=False), self.scale.astype(dtype), self.offset.astype(dtype)


def _properties(state: Any) -> dict[str, Any]:
    """Return field, columns and dataset of a scaler file; ValueError for anything but the document of `save`."""
    if not isinstance(state, dict) or set(state) != set(_KEYS):
        raise ValueError(f"its keys are not {', '.join(_KEYS)}")
    if state["scaler"] != _FORMAT or type(state["scaler"]) is not int:
        raise ValueError(f"layout {shown(state['scaler'])}; this version reads {_FORMAT}")
    bounds = (state["data_min"], state["data_max"])
    if not all(isinstance(bound, list) and all(type(v) in (int, float) for v in bound) for bound in bounds):
        raise ValueError("data_min and data_max are not lists of numbers")
    columns = state["columns"]
    if not isinstance(columns, list) or not all(isinstance(c, str) for c in [*columns, state["field"]]):
        raise ValueError("field and columns are not names")
    if not isinstance(state["dataset"], str) or state["dtype"] not in ("float32", "float16"):
        raise ValueError("dataset is not a hash, or dtype neither float32 nor float16")
    if columns and len(columns) != len(bounds[0]):
        raise ValueError(f"{len(columns)} columns, but {len(bounds[0])} numbers")
    if any(low > high for low, high in zip(*bounds, strict=True)):
        raise ValueError("a minimum is above its maximum")
    return {"field": state["field"], "columns": columns, "dataset": state["dataset"]}

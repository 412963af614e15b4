"""Scalers of columns, EDGE's min-max to [-1, 1] and z-scores, and their file."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Mirror
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import json_sha256
from dancedata.core.text import shown
from dancedata.core.typing import override
from dancedata.files import atomic
from dancedata.files.strict_json import read_json

#: Columns of float32 with a smaller range count as constant: 10 float32 eps, as in scikit-learn and EDGE.
CONSTANT_RANGE = 10 * float(np.finfo(np.float32).eps)
#: Layout of scaler files, and their keys.
_FORMAT = 1
_ABOUT = ("scaler", "field", "columns", "dataset", "dtype")
#: Far above the widest field, 4,800 columns with their names.
_MAX_BYTES = 1 << 24


class _Array(Protocol):
    """A numpy array or a torch tensor."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def clip(self, low: Any, high: Any, /) -> Any: ...


#: Values (..., D) of numpy or torch; results are of the same kind.
Values = TypeVar("Values", bound=_Array)


class Scaler(ABC):
    """An affine map of each column, which undoes itself; made of arrays, of a dataset, or of a file.

    Parameters
    ----------
    dtype
        Type that the data are stored in.
    field, columns, dataset
        Name of the field, names of its columns, and the hash of the dataset's own scaler of that field; "" and ()
        where that is unknown.
    """

    #: Names of its two numbers per column, in its file.
    numbers: ClassVar[tuple[str, str]]
    #: Size that few normalised values of motion exceed.
    usual: ClassVar[float]
    #: (D,) whether a column counts as constant: float32 below a range of 10 eps, float16 below 10 of its steps.
    constant: npt.NDArray[np.bool_]

    def __init__(
        self,
        *values: npt.ArrayLike,
        dtype: npt.DTypeLike = np.float32,
        field: str = "",
        columns: Sequence[str] = (),
        dataset: str = "",
    ) -> None:
        self._values = tuple(np.asarray(value, dtype=np.float64) for value in values)
        self.dtype, self.field, self.columns, self.dataset = np.dtype(dtype), field, tuple(columns), dataset
        shapes = {value.shape for value in self._values}
        if len(shapes) != 1 or self._values[0].ndim != 1:
            raise UsageError(f"a scaler requires one {self.numbers[0]} and one {self.numbers[1]} per column",
                             found=f"shapes {' and '.join(str(value.shape) for value in self._values)}")  # fmt: skip
        # Values of a store are float32; larger bounds would overflow range and scale.
        if any(not (np.abs(value) <= np.finfo(np.float32).max).all() for value in self._values):
            raise UsageError("a scaler has a bound that is not a finite float32")

    @property
    @abstractmethod
    def steps(self) -> tuple[tuple[Callable[[Any, Any], Any], npt.NDArray[np.float64]], ...]:
        """Operations that normalise, in order, each with its operand (D,)."""

    @property
    def width(self) -> int:
        """Number of columns D."""
        return len(self._values[0])

    @cached_property
    def sha256(self) -> str:
        """Hash of the numbers, by which checkpoints, exports and pools name the scaler."""
        return json_sha256(self.state_dict())

    def normalize(self, x: Values, clip: bool = False) -> Values:
        """Map x, (..., D) numpy or torch.

        Values outside the range in training go beyond, and come back whole; with `clip` they are cut to [-1, 1], as
        EDGE and Lodge do. Arithmetic and result are float32 for half precision (float16, bfloat16), float64 for
        integers, else of x's type.
        """
        self.require_range(clip)
        values, operands = self._like(x)
        for (operation, _), operand in zip(self.steps, operands, strict=True):
            values = operation(values, operand)
        scaled: Values = values
        return scaled.clip(-1, 1) if clip else scaled

    def unnormalize(self, x: Values, clip: bool = False) -> Values:
        """Invert `normalize`, in its types; with `clip`, x is first clipped to [-1, 1], as EDGE does."""
        self.require_range(clip)
        values, operands = self._like(x)
        values = values.clip(-1, 1) if clip else values
        for (operation, _), operand in zip(reversed(self.steps), reversed(operands), strict=True):
            values = _INVERSE[operation](values, operand)
        unscaled: Values = values
        return unscaled

    def require_range(self, clip: bool) -> None:
        """Check that values may be cut to [-1, 1] if they are to be; UsageError for a scaler without that range."""
        if clip and not isinstance(self, MinMax):
            raise UsageError("z-scores have no range to cut values to", fix="leave clip=True out, or give clip=False")

    def state_dict(self) -> dict[str, Any]:
        """Return the input of `from_state`, as plain JSON data."""
        state: dict[str, Any] = {n: v.tolist() for n, v in zip(self.numbers, self._values, strict=True)}
        return state if self.dtype == np.float32 else {**state, "dtype": self.dtype.name}

    @classmethod
    def from_state(cls, state: Mapping[str, Any], **properties: Any) -> Self:
        """Read the result of `state_dict`; `properties` are further arguments of the scaler."""
        values = [state[name] for name in cls.numbers]
        return cls(*values, **{"dtype": state.get("dtype", np.float32), **properties})

    def save(self, path: str | Path) -> None:
        """Write the scaler to a JSON file, for ``scaler=`` and ``--scaler``, with the field that it is of.

        Raises
        ------
        StoreError
            If it cannot be written.
        """
        about = (_FORMAT, self.field, list(self.columns), self.dataset, self.dtype.name)
        values = {name: value.tolist() for name, value in zip(self.numbers, self._values, strict=True)}
        state = {**dict(zip(_ABOUT, about, strict=True)), **values, "sha256": self.sha256}
        try:
            atomic.write_json(Path(path).expanduser(), state)
        except OSError as error:
            raise StoreError("the scaler cannot be written", where=path, found=str(error)) from error

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file of `save`; ``Scaler.load`` reads one of any scaler.

        Raises
        ------
        UsageError
            If it cannot be read, is not such a file, or was changed.
        """
        try:
            state = read_json(Path(path).expanduser(), _MAX_BYTES)
            kind = next((k for k in (MinMax, ZScore) if issubclass(k, cls) and _has_keys(state, k)), None)
            if kind is None:
                raise ValueError("its keys are not those of a scaler")
            normalizer = kind.from_state(state, **_properties(state, kind))
            if normalizer.sha256 != state["sha256"]:
                raise ValueError("the numbers are not those of its hash")
        except (OSError, ValueError, TypeError, OverflowError, UsageError) as error:
            raise UsageError(
                "not a scaler file", where=path, found=shown(error), allowed="a file of normalizer.save(...)"
            ) from error
        return normalizer  # type: ignore[return-value]  # a subclass of cls

    def require(self, *, field: str, columns: Sequence[str], dataset: str = "") -> Self:
        """Return this scaler if it can be of a field; what is unknown on one side, "" or (), is not compared.

        Raises
        ------
        UsageError
            For another width, field, columns or dataset.
        """
        fix = f"give the scaler that training used; to use this one all the same: {self._bare}"
        if self.width != len(columns):
            raise UsageError("the scaler has a different width", where=f"field {field}",
                             found=f"{self.width} columns", allowed=len(columns), fix=fix)  # fmt: skip
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

    @property
    def _bare(self) -> str:
        return f"{type(self).__name__}({', '.join(f's.{name}' for name in self.numbers)})"

    def _below(self, spread: npt.NDArray[np.float64], magnitude: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        step = 10 * float(np.finfo(np.float16).eps) if self.dtype == np.float16 else 0.0
        return np.asarray(spread < np.maximum(CONSTANT_RANGE, step * magnitude))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.width} columns, {int(self.constant.sum())} of them constant)"

    def _like(self, x: Any) -> tuple[Any, list[Any]]:
        """Return x in the type of the arithmetic, and the operands."""
        if x.shape[-1] != self.width:
            raise UsageError("the scaler has a different width", found=f"{x.shape[-1]} columns", allowed=self.width)
        if hasattr(x, "new_tensor"):
            x = x.double() if not x.is_floating_point() else x.float() if x.element_size() < 4 else x
            return x, [x.new_tensor(operand) for _, operand in self.steps]
        dtype = np.promote_types(x.dtype, np.float32) if np.issubdtype(x.dtype, np.floating) else np.dtype(np.float64)
        return x.astype(dtype, copy=False), [operand.astype(dtype) for _, operand in self.steps]


class MinMax(Scaler):
    """Scale columns to [-1, 1] by their minimum and maximum in training (EDGE, Tseng et al. 2023).

    A column that is constant in training gets a range of 1, so that its value maps to -1.

    Parameters
    ----------
    data_min, data_max
        (D,) minimum and maximum of the training data. Columns of float16 count as constant below 10 of its steps at
        their magnitude, those of float32 below 10 eps, as in EDGE.
    **properties
        dtype, field, columns and dataset, as of `Scaler`.
    """

    numbers = ("data_min", "data_max")
    usual = 1.0

    def __init__(self, data_min: npt.ArrayLike, data_max: npt.ArrayLike, **properties: Any) -> None:
        super().__init__(data_min, data_max, **properties)
        self.data_min, self.data_max = self._values
        self.data_range = self.data_max - self.data_min
        self.constant = self._below(self.data_range, np.maximum(np.abs(self.data_min), np.abs(self.data_max)))
        safe = np.where(self.constant, 1.0, self.data_range)
        self.scale = 2.0 / safe
        self.offset = -1.0 - self.data_min * self.scale

    @property
    @override
    def steps(self) -> tuple[tuple[Callable[[Any, Any], Any], npt.NDArray[np.float64]], ...]:
        return (operator.mul, self.scale), (operator.add, self.offset)

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


class ZScore(Scaler):
    """Subtract the mean of each column in training, and divide by its standard deviation.

    The scaling of text-to-motion (HumanML3D, Guo et al. 2022): ``store.zscore(FIELD, grouped=True)``, or of the
    arrays of its Mean.npy and Std.npy, ``ZScore(mean, std)``. A column that is constant in training is divided by 1.

    Parameters
    ----------
    mean, std
        (D,) mean and standard deviation (of the population, ddof 0) of the training data.
    **properties
        dtype, field, columns and dataset, as of `Scaler`.
    """

    numbers = ("mean", "std")
    usual = 3.0

    def __init__(self, mean: npt.ArrayLike, std: npt.ArrayLike, **properties: Any) -> None:
        super().__init__(mean, std, **properties)
        self.mean, self.std = self._values
        if (self.std < 0).any():
            raise UsageError("a standard deviation is negative", found=f"{self.std.min():.3g}")
        self.constant = self._below(self.std, np.abs(self.mean))

    @property
    @override
    def steps(self) -> tuple[tuple[Callable[[Any, Any], Any], npt.NDArray[np.float64]], ...]:
        return (operator.sub, self.mean), (operator.truediv, np.where(self.constant, 1.0, self.std))


_INVERSE: Mapping[Callable[[Any, Any], Any], Callable[[Any, Any], Any]] = {
    operator.mul: operator.truediv, operator.add: operator.sub, operator.sub: operator.add,
    operator.truediv: operator.mul,
}  # fmt: skip


def _has_keys(state: Any, kind: type[Scaler]) -> bool:
    return isinstance(state, dict) and set(state) == {*_ABOUT, *kind.numbers, "sha256"}


def _properties(state: Any, kind: type[Scaler]) -> dict[str, Any]:
    """Return field, columns and dataset of a scaler file; ValueError for anything but the document of `save`."""
    if state["scaler"] != _FORMAT or type(state["scaler"]) is not int:
        raise ValueError(f"layout {shown(state['scaler'])}; this version reads {_FORMAT}")
    bounds = [state[name] for name in kind.numbers]
    if not all(isinstance(bound, list) and all(type(v) in (int, float) for v in bound) for bound in bounds):
        raise ValueError(f"{' and '.join(kind.numbers)} are not lists of numbers")
    columns = state["columns"]
    if not isinstance(columns, list) or not all(isinstance(c, str) for c in [*columns, state["field"]]):
        raise ValueError("field and columns are not names")
    if not isinstance(state["dataset"], str) or state["dtype"] not in ("float32", "float16"):
        raise ValueError("dataset is not a hash, or dtype neither float32 nor float16")
    if columns and len(columns) != len(bounds[0]):
        raise ValueError(f"{len(columns)} columns, but {len(bounds[0])} numbers")
    if kind is MinMax and any(low > high for low, high in zip(*bounds, strict=True)):
        raise ValueError("a minimum is above its maximum")
    return {"field": state["field"], "columns": columns, "dataset": state["dataset"]}

"""Scaler: EDGE's min-max to [-1, 1] or z-scores of columns, and its file."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError, UsageError, did_you_mean
from dancedata.core.hashing import json_sha256
from dancedata.core.text import listed, shown
from dancedata.files import atomic
from dancedata.files.strict_json import read_json

if TYPE_CHECKING:
    from dancedata.core.plugins import SampleField
    from dancedata.core.sample_steps import Step

Kind = Literal["minmax", "zscore"]
#: Names of the two numbers of each column, in its file.
_NUMBERS: Mapping[str, tuple[str, str]] = {"minmax": ("data_min", "data_max"), "zscore": ("mean", "std")}
#: Layout of scaler files, and their keys.
_FORMAT = 1
_ABOUT = ("scaler", "field", "columns", "dataset", "dtype")
#: Far above the widest field, 4,800 columns with their names.
_MAX_BYTES = 1 << 24


class TrainingData(Protocol):
    """A `WindowDataset` or `ClipDataset` with the scalers of its fields, which training reads."""

    @property
    def store(self) -> Any:
        """The dataset."""

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields that it reads."""

    @property
    def normalized(self) -> tuple[str, ...]:
        """Names of the fields that it normalises."""

    def scaler(self, field: str) -> Scaler:
        """Return the scaler of a field: of one that is not normalised, what normalising it would use."""


class _Array(Protocol):
    """A numpy array or a torch tensor."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def clip(self, low: Any, high: Any, /) -> Any: ...


#: Values (..., D) of numpy or torch; results are of the same kind.
Values = TypeVar("Values", bound=_Array)


class Scaler:
    """Scale each column by two numbers, and back; made of arrays, of a dataset (`Store.scaler`), or of a file.

    Parameters
    ----------
    kind
        "minmax": ``x * scale + offset``, to [-1, 1] by the range in training (EDGE, Tseng et al. 2023); a constant
        column gets a range of 1, so that its value maps to -1. "zscore": ``(x - mean) / std``, as text-to-motion
        (HumanML3D, Guo et al. 2022); a constant column is divided by 1.
    first, second
        (D,) minimum and maximum of the training data, kept as `data_min` and `data_max`; or mean and standard
        deviation (of the population, ddof 0), kept as `mean` and `std`.
    dtype
        Type that the data are stored in. Columns of float16 count as constant below 10 of its steps at their
        magnitude, those of float32 below 10 eps, as in EDGE.
    field, columns, dataset
        Name of the field, names of its columns, and the hash of the dataset's own scaler of that field; "" and ()
        where that is unknown.

    Raises
    ------
    UsageError
        For another kind, numbers of different shapes, that are not finite, or a negative deviation.

    Attributes
    ----------
    constant
        (D,) whether a column counts as constant.
    """

    data_min: npt.NDArray[np.float64]
    data_max: npt.NDArray[np.float64]
    mean: npt.NDArray[np.float64]
    std: npt.NDArray[np.float64]

    #: Columns of float32 with a smaller range count as constant: 10 float32 eps, as in scikit-learn and EDGE.
    CONSTANT_RANGE: ClassVar[float] = 10 * float(np.finfo(np.float32).eps)

    def __init__(
        self,
        kind: Kind,
        first: npt.ArrayLike,
        second: npt.ArrayLike,
        *,
        dtype: npt.DTypeLike = np.float32,
        field: str = "",
        columns: Sequence[str] = (),
        dataset: str = "",
    ) -> None:
        if kind not in _NUMBERS:
            raise UsageError(f"unknown kind of scaler {kind!r}", fix=did_you_mean(kind, _NUMBERS))
        self.kind, self.numbers = kind, _NUMBERS[kind]
        low, high = (np.asarray(value, dtype=np.float64) for value in (first, second))
        vars(self).update(zip(self.numbers, (low, high), strict=True))
        self.dtype, self.field, self.columns, self.dataset = np.dtype(dtype), field, tuple(columns), dataset
        if low.shape != high.shape or low.ndim != 1:
            raise UsageError(f"a scaler requires one {self.numbers[0]} and one {self.numbers[1]} per column",
                             found=f"shapes {low.shape} and {high.shape}")  # fmt: skip
        # Values of a store are float32; larger bounds would overflow range and scale.
        if any(not (np.abs(value) <= np.finfo(np.float32).max).all() for value in (low, high)):
            raise UsageError("a scaler has a bound that is not a finite float32")
        ranges = kind == "minmax"
        if not ranges and (high < 0).any():
            raise UsageError("a standard deviation is negative", found=f"{high.min():.3g}")
        #: Size that few normalised values of motion exceed.
        self.usual = 1.0 if ranges else 3.0
        #: (D,) range of each column, or its deviation.
        self.data_range = high - low if ranges else high
        step = 10 * float(np.finfo(np.float16).eps) if self.dtype == np.float16 else 0.0
        magnitude = np.maximum(np.abs(low), np.abs(high)) if ranges else np.abs(low)
        self.constant = np.asarray(self.data_range < np.maximum(self.CONSTANT_RANGE, step * magnitude))
        safe = np.where(self.constant, 1.0, self.data_range)
        self.scale = 2.0 / safe if ranges else 1.0 / safe
        self.offset = -1.0 - low * self.scale if ranges else -low * self.scale
        #: Operations that normalise, in order, each with its operand (D,): with `scale` and `offset` alone z-scores
        #: of a small deviation would cancel.
        self.steps: tuple[tuple[Callable[[Any, Any], Any], npt.NDArray[np.float64]], ...] = (
            ((operator.mul, self.scale), (operator.add, self.offset))
            if ranges
            else ((operator.sub, low), (operator.truediv, safe))
        )

    @property
    def width(self) -> int:
        """Number of columns D."""
        return len(self.constant)

    @cached_property
    def sha256(self) -> str:
        """Hash of the numbers, by which checkpoints, exports and pools name the scaler."""
        return json_sha256(self.state_dict())

    def normalize(self, x: Values, clamp: bool = False) -> Values:
        """Map x, (..., D) numpy or torch.

        Values outside the range in training go beyond, and come back whole; with `clamp` they are cut to [-1, 1], as
        EDGE and Lodge do. Arithmetic and result are float32 for half precision (float16, bfloat16), float64 for
        integers, else of x's type.
        """
        self.require_range(clamp)
        values, operands = self._like(x)
        for (operation, _), operand in zip(self.steps, operands, strict=True):
            values = operation(values, operand)
        scaled: Values = values
        return scaled.clip(-1, 1) if clamp else scaled

    def unnormalize(self, x: Values, clamp: bool = False) -> Values:
        """Invert `normalize`, in its types; with `clamp`, x is first cut to [-1, 1], as EDGE does."""
        self.require_range(clamp)
        values, operands = self._like(x)
        values = values.clip(-1, 1) if clamp else values
        for (operation, _), operand in zip(reversed(self.steps), reversed(operands), strict=True):
            values = _INVERSE[operation](values, operand)
        unscaled: Values = values
        return unscaled

    def require_range(self, clamp: bool) -> None:
        """Check that values may be cut to [-1, 1] if they are to be; UsageError for a scaler without that range."""
        if clamp and self.kind != "minmax":
            raise UsageError(
                "z-scores have no range to cut values to", fix="leave clamp=True out, or give clamp=False"
            )

    def covering(self, field: SampleField, steps: Iterable[Step]) -> Scaler:
        """Return the scaler whose range covers what augmentations make of motion; of another field, this one."""
        steps = tuple(steps)
        if not steps or field.kind != "motion":
            return self
        low, high = self.data_min, self.data_max
        for step in steps:
            if step.p > 0:
                low, high = step.augmentation.scaler_bounds(low, high, field)
        if low is self.data_min and high is self.data_max:
            return self
        return Scaler(
            self.kind, low, high, dtype=self.dtype, field=self.field, columns=self.columns, dataset=self.dataset
        )

    def state_dict(self) -> dict[str, Any]:
        """Return the input of `from_state`, as plain JSON data."""
        state: dict[str, Any] = {name: getattr(self, name).tolist() for name in self.numbers}
        return state if self.dtype == np.float32 else {**state, "dtype": self.dtype.name}

    @classmethod
    def from_state(cls, state: Mapping[str, Any], **properties: Any) -> Self:
        """Read the result of `state_dict`; `properties` are further arguments of the scaler."""
        kind: Kind = "zscore" if "mean" in state else "minmax"
        first, second = (state[name] for name in _NUMBERS[kind])
        return cls(kind, first, second, **{"dtype": state.get("dtype", np.float32), **properties})

    def save(self, path: str | Path) -> None:
        """Write the scaler to a JSON file, for ``scaler=`` and ``--scaler``, with the field that it is of.

        Raises StoreError: if it cannot be written.
        """
        about = (_FORMAT, self.field, list(self.columns), self.dataset, self.dtype.name)
        state = {**dict(zip(_ABOUT, about, strict=True)), **self.state_dict(), "sha256": self.sha256}
        try:
            atomic.write_json(Path(path).expanduser(), state)
        except OSError as error:
            raise StoreError("the scaler cannot be written", where=path, found=str(error)) from error

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file of `save`.

        Raises UsageError: if it cannot be read, is not such a file, or was changed.
        """
        try:
            state = read_json(Path(path).expanduser(), _MAX_BYTES)
            scaler = cls.from_state(state, **_properties(state))
            if scaler.sha256 != state["sha256"]:
                raise ValueError("the numbers are not those of its hash")
        except (OSError, ValueError, TypeError, OverflowError, UsageError) as error:
            raise UsageError(
                "not a scaler file", where=path, found=shown(error), allowed="a file of scaler.save(...)"
            ) from error
        return scaler

    def require(self, *, field: str, columns: Sequence[str], dataset: str = "") -> Self:
        """Return this scaler if it can be of a field; what is unknown on one side, "" or (), is not compared.

        Raises UsageError: for another width, field, columns or dataset.
        """
        bare = f"Scaler({self.kind!r}, {', '.join(f's.{name}' for name in self.numbers)})"
        fix = f"give the scaler that training used; to use this one all the same: {bare}"
        if self.width != len(columns):
            raise UsageError("the scaler has a different width", where=f"field {field}",
                             found=f"{self.width} columns", allowed=len(columns), fix=fix)  # fmt: skip
        for property_, actual, expected in (
            ("field", self.field, field),
            ("columns", ", ".join(self.columns), ", ".join(columns)),
            ("dataset", self.dataset, dataset),
        ):
            if actual and expected and actual != expected:
                raise UsageError(f"the scaler was fitted on another {property_}", where=f"field {field}",
                                 found=shown(actual), fix=fix)  # fmt: skip
        return self

    def __repr__(self) -> str:
        return f"Scaler({self.kind!r}, {self.width} columns, {int(self.constant.sum())} of them constant)"

    def _like(self, x: Any) -> tuple[Any, list[Any]]:
        """Return x in the type of the arithmetic, and the operands."""
        if x.shape[-1] != self.width:
            raise UsageError("the scaler has a different width", found=f"{x.shape[-1]} columns", allowed=self.width)
        if hasattr(x, "new_tensor"):
            x = x.double() if not x.is_floating_point() else x.float() if x.element_size() < 4 else x
            return x, [x.new_tensor(operand) for _, operand in self.steps]
        dtype = np.promote_types(x.dtype, np.float32) if np.issubdtype(x.dtype, np.floating) else np.dtype(np.float64)
        return x.astype(dtype, copy=False), [operand.astype(dtype) for _, operand in self.steps]


def scaler_from(source: Scaler | str | Path | TrainingData, field: str) -> Scaler:
    """Return a scaler, that of its file, or that of a reader of a field; UsageError for anything else."""
    if isinstance(source, Scaler | str | Path):
        return source if isinstance(source, Scaler) else Scaler.load(source)
    if not hasattr(source, "normalized"):
        raise UsageError("this is not a scaler", found=shown(source),
                         allowed="a scaler, its file, or a reader or a Mix that has it",
                         fix="of a dataset, give its scaler(FIELD)")  # fmt: skip
    if field not in source.fields:
        raise UsageError(f"the reader that names the scaler does not read {field!r}", found=listed(source.fields),
                         fix="name a reader of this field")  # fmt: skip
    return source.scaler(field)


_INVERSE: Mapping[Callable[[Any, Any], Any], Callable[[Any, Any], Any]] = {
    operator.mul: operator.truediv, operator.add: operator.sub, operator.sub: operator.add,
    operator.truediv: operator.mul,
}  # fmt: skip


def _properties(state: Any) -> dict[str, Any]:
    """Return field, columns and dataset of a scaler file; ValueError for anything but the document of `save`."""
    keys = set(state) if isinstance(state, dict) else set()
    numbers = next((names for names in _NUMBERS.values() if keys == {*_ABOUT, *names, "sha256"}), None)
    if numbers is None:
        raise ValueError("its keys are not those of a scaler")
    if state["scaler"] != _FORMAT or type(state["scaler"]) is not int:
        raise ValueError(f"layout {shown(state['scaler'])}; this version reads {_FORMAT}")
    bounds = [state[name] for name in numbers]
    if not all(isinstance(bound, list) and all(type(v) in (int, float) for v in bound) for bound in bounds):
        raise ValueError(f"{' and '.join(numbers)} are not lists of numbers")
    columns = state["columns"]
    if not isinstance(columns, list) or not all(isinstance(c, str) for c in [*columns, state["field"]]):
        raise ValueError("field and columns are not names")
    if not isinstance(state["dataset"], str) or state["dtype"] not in ("float32", "float16"):
        raise ValueError("dataset is not a hash, or dtype neither float32 nor float16")
    if columns and len(columns) != len(bounds[0]):
        raise ValueError(f"{len(columns)} columns, but {len(bounds[0])} numbers")
    if numbers == _NUMBERS["minmax"] and any(low > high for low, high in zip(*bounds, strict=True)):
        raise ValueError("a minimum is above its maximum")
    return {"field": state["field"], "columns": columns, "dataset": state["dataset"]}

"""Pickles of body models as they are published: chumpy arrays and scipy's sparse matrices, without their classes."""

from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.errors import DataError
from dancedata.core.text import shown
from dancedata.formats.safe_pickle import (
    ARRAY_NAMES,
    ClassName,
    Names,
    StandIn,
    as_array,
    is_shape,
    load_pickle,
    make,
)
from dancedata.formats.values import ValueArrays

_CH, _SELECT, _CSC, _CSR = "chumpy.ch.Ch", "chumpy.reordering.Select", "csc_matrix", "csr_matrix"
#: Elements of a dense matrix; SMPL-X's regressor has 55 x 10,475.
_MAX_DENSE = 1 << 24

Array = np.ndarray[Any, Any]

_NAMES: Names = {
    **ARRAY_NAMES,
    ("chumpy.ch", "Ch"): ClassName(_CH, makes=True),
    ("chumpy", "Ch"): ClassName(_CH, makes=True),
    ("chumpy.reordering", "Select"): ClassName(_SELECT, makes=True),
    **{
        (f"scipy.sparse.{module}", f"{name}_matrix"): ClassName(f"{name}_matrix", makes=True)
        for name in ("csc", "csr")
        for module in (name, f"_{name}")
    },
    **{(package, "object"): ClassName("object") for package in ("builtins", "__builtin__")},
    **{(package, "_reconstructor"): make for package in ("copyreg", "copy_reg")},
}


def open_model_pickle(path: Path) -> ValueArrays:
    """Return the arrays of a body model; DataError also for contradictory sparse matrices and chumpy arrays."""
    content = load_pickle(path, _NAMES)
    if not isinstance(content, dict):
        content = {}
    return ValueArrays(path, {name: _value(path, name, value) for name, value in content.items()})


def _value(path: Path, name: object, value: object) -> object:
    if not isinstance(value, StandIn):
        return value
    try:
        return _array(value)
    except Exception as error:  # of indices and shapes that a crafted file states
        raise DataError(f"{shown(name)} is not an array as {value.name} holds it", reason="broken_file", where=path,
                        found=shown(error), fix="download the model again") from error  # fmt: skip


def _array(value: StandIn) -> Array:
    state = value.state or {}
    if value.name == _CH:
        return _numbers(state["x"])
    if value.name == _SELECT:
        source = state["a"]
        if isinstance(source, StandIn) and source.name == _CH:
            source = (source.state or {})["x"]
        taken = _numbers(source).reshape(-1)[_indices(state["idxs"])]
        shape = state.get("preferred_shape", taken.shape)
        if not is_shape(shape):
            raise ValueError(f"a shape {shown(shape)}")
        return taken.reshape(shape)
    return _dense(value.name, state)


def _numbers(value: object) -> Array:
    array = as_array(value)
    if array is None or array.dtype.kind not in "fiu":
        raise ValueError(f"not an array of numbers: {shown(value)}")
    return array


def _indices(value: object) -> Array:
    array = _numbers(value)
    if array.dtype.kind not in "iu":
        raise ValueError("indices that are not whole numbers")
    return array


def _dense(kind: str, state: dict[str, Any]) -> Array:
    from scipy import sparse

    shape = state["_shape"] if "_shape" in state else state["shape"]
    if not is_shape(shape) or len(shape) != 2 or shape[0] * shape[1] > _MAX_DENSE:
        raise ValueError(f"a matrix of shape {shown(shape)}")
    parts = (_numbers(state["data"]), _indices(state["indices"]), _indices(state["indptr"]))
    matrix = (sparse.csc_matrix if kind == _CSC else sparse.csr_matrix)(parts, shape=shape)
    matrix.check_format(full_check=True)
    return np.asarray(matrix.toarray())

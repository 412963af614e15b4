"""Names and states in the pickles of numpy and joblib: stand-ins for functions, and the states that are written.

numpy does not validate the state of an array or a dtype: a wrong dtype flag would turn bytes of the file into
pointers. joblib.dump writes the description of an array in the pickle, and the values as raw bytes behind its
opcodes::

    NEWOBJ joblib.numpy_pickle.NumpyArrayWrapper, BUILD {subclass, shape, order, dtype, allow_mmap,
    numpy_array_alignment_bytes}, then one byte n and n bytes of padding (joblib 1.2 and later), then the values

In their place arrays of objects have another pickle. Arrays are views of the file's bytes.
"""

import math
from typing import Any

import numpy as np

from dancedata.core.text import shown
from dancedata.formats.checked_unpickler import ClassName, frozen_set, invalid, mutable_set, ordered_dict

MAX_DIMENSIONS = 32
#: Bound of a dimension, so that their product is a number of bounded size.
MAX_LENGTH = 1 << 29

INVALID_ARRAY = "an array is built in a way that numpy never writes"


class NdarrayName:
    """Placeholder for numpy.ndarray: may be named but not called, as a call could allocate any amount of memory."""


def reconstruct(kind: object, shape: object, code: object) -> np.ndarray[Any, Any]:
    """Make an empty array, whose state is set later."""
    if kind is not NdarrayName or type(shape) is not tuple or shape != (0,):
        raise invalid(INVALID_ARRAY)
    return np.empty((0,), dtype=np.int8)


def _dtype(code: object, align: object = False, copy: object = False) -> np.dtype[Any]:
    # Long codes describe structured dtypes, which numpy takes seconds to parse.
    if type(code) is not str or len(code) > 20:
        raise invalid(f"an array of type {shown(code)}")
    # A copy, because its byte order is set later. Structured dtypes, subarrays and dates are not needed.
    dtype: np.dtype[Any] = np.dtype(code, copy=True)
    if dtype.kind not in "biufcSUO":
        raise invalid(f"arrays of type {shown(code)} are not read")
    return dtype


def _frombuffer(buffer: Any, dtype: Any, shape: Any, order: Any, axes: Any = None) -> np.ndarray[Any, Any]:
    # Not of an array: its buffer could be replaced later, which would leave this array dangling.
    plain = type(buffer) in (bytes, bytearray) and isinstance(dtype, np.dtype) and type(order) is str
    if not plain or not is_shape(shape) or not (order in ("C", "F") or (order == "K" and is_shape(axes))):
        raise invalid(INVALID_ARRAY)
    array = np.frombuffer(buffer, dtype=dtype)
    # numpy 2.3 and later: an array whose axes are permuted in memory.
    return array.reshape(shape).transpose(axes) if order == "K" else array.reshape(shape, order=order)


def _scalar(dtype: Any, data: Any) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject or type(data) not in (bytes, str):
        raise invalid("a numpy scalar that numpy never writes")
    raw = data.encode("latin1") if isinstance(data, str) else data
    return np.frombuffer(raw, dtype=dtype, count=1)[0]


def _encode(text: object, encoding: object = "latin1") -> bytes:
    # Protocol 2 writes bytes as _codecs.encode(text, "latin1"), the only call that is needed.
    if type(text) is not str or type(encoding) is not str or encoding not in ("latin1", "latin-1"):
        raise invalid(f"a {type(text).__name__} encoded as {shown(encoding)}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    # Protocol 2 writes b"" as bytes(); bytes(n) could allocate any amount of memory.
    return b""


ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): NdarrayName,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): ordered_dict,
}
for _package in ("numpy.core", "numpy._core"):
    ALLOWED[_package + ".multiarray", "_reconstruct"] = reconstruct
    ALLOWED[_package + ".multiarray", "scalar"] = _scalar
    ALLOWED[_package + ".numeric", "_frombuffer"] = _frombuffer
for _package in ("builtins", "__builtin__"):
    ALLOWED[_package, "set"] = mutable_set
    ALLOWED[_package, "frozenset"] = frozen_set
    ALLOWED[_package, "bytes"] = _no_bytes


def is_shape(shape: object) -> bool:
    """Return whether it can be an array's shape: its product is then a number of bounded size."""
    if type(shape) is not tuple or len(shape) > MAX_DIMENSIONS:
        return False
    return all(type(n) is int and 0 <= n <= MAX_LENGTH for n in shape)


def is_dtype_state(target: np.dtype[Any], state: tuple[Any, ...]) -> bool:
    """Return whether numpy writes this state of a dtype: its byte order, and nothing that differs."""
    plain = np.dtype(target.str).__reduce__()[2]
    if len(state) != len(plain) or any(type(value) not in (int, str, type(None)) for value in state):
        return False
    return state[1] in ("<", ">", "|", "=") and (state[0], *state[2:]) == (3, *plain[2:])


def is_array_state(unpickler: Any, state: tuple[Any, ...]) -> bool:
    """Return whether numpy writes this state of an array. `unpickler` has the arrays without a state yet."""
    version, shape, dtype, fortran, data = state
    if type(version) is not int or type(fortran) not in (bool, int) or not isinstance(dtype, np.dtype):
        return False
    if type(data) not in (bytes, str, list) or not is_shape(shape):
        return False
    if type(data) is not list:
        return True
    # numpy allocates the shape before it counts the objects. Nested arrays of objects would recurse without bound;
    # an unfinished array can still become one of objects.
    nested = any(isinstance(v, np.ndarray) and (v.dtype.hasobject or id(v) in unpickler.unfinished) for v in data)
    return math.prod(shape) == len(data) and not nested


#: The class of joblib's description of an array.
WRAPPER = "joblib.numpy_pickle.NumpyArrayWrapper"
_NAMES = {"subclass", "shape", "order", "dtype", "allow_mmap", "numpy_array_alignment_bytes"}

#: Further names in joblib's files.
NamesOfJoblib: dict[tuple[str, str], Any] = {
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): ClassName(WRAPPER, makes=True),
    # Older copies of joblib.
    ("sklearn.externals.joblib.numpy_pickle", "NumpyArrayWrapper"): ClassName(WRAPPER, makes=True),
    ("numpy", "memmap"): ALLOWED["numpy", "ndarray"],
}


def read_array(unpickler: Any, state: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Read the array that follows its description, and leave the position of the file behind it."""
    frame = unpickler._unframer.current_frame
    if frame is not None and frame.read(1):
        raise invalid("an array within a frame of the pickle")
    if not {"subclass", "shape", "order", "dtype"} <= set(state) <= _NAMES:
        raise invalid(INVALID_ARRAY)
    shape, order, dtype = state["shape"], state["order"], state["dtype"]
    plain = isinstance(dtype, np.dtype) and type(order) is str and order in ("C", "F")
    if not plain or not is_shape(shape) or state["subclass"] is not NdarrayName:
        raise invalid(INVALID_ARRAY)
    if dtype.hasobject:
        array = unpickler.load_inner()
        if not isinstance(array, np.ndarray) or array.shape != shape or not array.dtype.hasobject:
            raise invalid("an array of objects that is none")
        return array
    if state.get("numpy_array_alignment_bytes") is not None:
        unpickler.take(unpickler.take(1)[0])
    count = math.prod(shape)
    values = np.frombuffer(unpickler.take(count * dtype.itemsize), dtype=dtype, count=count)
    return values.reshape(shape, order=order)

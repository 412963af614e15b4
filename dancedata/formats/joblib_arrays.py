"""Arrays as joblib.dump writes them: the description in the pickle, and the values as raw bytes behind its opcodes.

::

    NEWOBJ joblib.numpy_pickle.NumpyArrayWrapper, BUILD {subclass, shape, order, dtype, allow_mmap,
    numpy_array_alignment_bytes}, then one byte n and n bytes of padding (joblib 1.2 and later), then the values

Arrays of objects are a pickle of their own in that place. The values are not copied: arrays are views of the file's
bytes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dancedata.formats.checked_unpickler import invalid
from dancedata.formats.numpy_pickle import ALLOWED, INVALID_ARRAY, NdarrayName, is_shape
from dancedata.formats.stand_in import ClassName

__all__ = ["WRAPPER", "NamesOfJoblib", "read_array"]

#: The class of joblib's description of an array.
WRAPPER = "joblib.numpy_pickle.NumpyArrayWrapper"
_NAMES = {"subclass", "shape", "order", "dtype", "allow_mmap", "numpy_array_alignment_bytes"}

#: What joblib's files name beside what `safe_pickle` allows.
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

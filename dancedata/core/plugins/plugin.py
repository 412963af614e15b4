"""The base of all plug-ins."""

from abc import ABC
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]


class Plugin(ABC):
    """Base of all plug-ins.

    A parameter that names a file has the metadata ``{"path": True, "content": True}``: the bytes of the file are part
    of the cache keys, its place is not. An audio feature hashes its files in `resolved`.

    Attributes
    ----------
    name
        What recipes call it; set by the registry.
    version
        To be raised from 1 whenever the same input results in other numbers: it is part of the cache keys.
    """

    name: ClassVar[str]
    version: ClassVar[int] = 1
    __dataclass_fields__: ClassVar[dict[str, Any]]

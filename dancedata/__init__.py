"""dancedata: the data layer of music-to-dance generation.

Motion capture and music go in; what any trainer needs comes out, in one documented HDF5 dataset.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dancedata.core.version import __version__

if TYPE_CHECKING:
    from dancedata.pipeline.api import decode, encode, extract
    from dancedata.store.dataset import open_store as open

__all__ = ["__version__", "decode", "encode", "extract", "open"]

#: Public name -> where it lives. Looked up on first use, so that `import dancedata` stays light.
_LAZY = {
    "open": ("dancedata.store.dataset", "open_store"),
    "extract": ("dancedata.pipeline.api", "extract"),
    "encode": ("dancedata.pipeline.api", "encode"),
    "decode": ("dancedata.pipeline.api", "decode"),
}


def __getattr__(name: str) -> Any:
    try:
        module, attribute = _LAZY[name]
    except KeyError:
        raise AttributeError(f"module 'dancedata' has no attribute {name!r}") from None
    return getattr(importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})

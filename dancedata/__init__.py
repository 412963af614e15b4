"""dancedata: the data layer of music-to-dance generation.

Motion capture and music go in; what any trainer needs comes out, in one documented HDF5 dataset.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names
from dancedata.core.version import __version__

if TYPE_CHECKING:
    from dancedata.pipeline.api import decode, encode, extract
    from dancedata.store.dataset import open_store as open

__all__ = ["__version__", "decode", "encode", "extract", "open"]

# Imported on first use, so that `import dancedata` stays fast.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "open": "dancedata.store.dataset:open_store",
        "extract": "dancedata.pipeline.api",
        "encode": "dancedata.pipeline.api",
        "decode": "dancedata.pipeline.api",
    },
)

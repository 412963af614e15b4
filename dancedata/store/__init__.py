"""The HDF5 store, format 3. Only this package depends on the file layout (docs/reference/store.md)."""

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = [
    "AudioBlock",
    "Clip",
    "ClipRecord",
    "Clips",
    "Field",
    "LazyArray",
    "Problem",
    "Signal",
    "Store",
    "StoreHeader",
    "StoredClip",
    "WindowList",
    "open_store",
    "verify_store",
    "write_store",
]

if TYPE_CHECKING:
    from dancedata.store.clip_columns import ClipRecord
    from dancedata.store.clip_view import Clip, Clips
    from dancedata.store.dataset import Store, open_store
    from dancedata.store.schema import Field, StoreHeader
    from dancedata.store.stored_clip import AudioBlock, LazyArray, Signal, StoredClip
    from dancedata.store.verify import verify_store
    from dancedata.store.verify_shard import Problem
    from dancedata.store.window_list import WindowList
    from dancedata.store.writer import write_store
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "store.clip_columns": "ClipRecord",
            "store.clip_view": "Clip Clips",
            "store.dataset": "Store open_store",
            "store.schema": "Field StoreHeader",
            "store.stored_clip": "AudioBlock LazyArray Signal StoredClip",
            "store.verify": "verify_store",
            "store.verify_shard": "Problem",
            "store.window_list": "WindowList",
            "store.writer": "write_store",
        },
    )

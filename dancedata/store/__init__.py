"""The HDF5 store, format 3. Only this package depends on the file layout (docs/reference/store.md)."""

from dancedata.store.clip_columns import ClipRecord
from dancedata.store.clip_view import Clip, Clips
from dancedata.store.dataset import Store, open_store
from dancedata.store.schema import Field, StoreHeader
from dancedata.store.stored_clip import AudioBlock, LazyArray, Signal, StoredClip
from dancedata.store.verify import verify_store
from dancedata.store.verify_shard import Problem
from dancedata.store.window_list import WindowList
from dancedata.store.writer import write_store

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

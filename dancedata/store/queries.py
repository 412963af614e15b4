"""What rooms ask of an open store beside its methods."""

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from dancedata.core.errors import DanceDataError
from dancedata.files.regular_file import sha256_file
from dancedata.files.strict_json import read_json
from dancedata.store.dataset_json import stated_weights
from dancedata.store.listed_file import FileHash
from dancedata.store.schema import LOCAL_FILE, SEGMENTS_FILE, TABLES_FILE, Field, Kind
from dancedata.store.segment_overlay import SegmentOverlay
from dancedata.store.store_tables import StoreTables

#: Largest local.json: a path.
_MAX_LOCAL = 1 << 16


def fields_with(store: StoreTables, *groups: str, kind: Kind = "audio") -> tuple[Field, ...]:
    """Return the fields of a kind that have these groups of columns, such as "beat", in the dataset's order."""
    return tuple(f for f in map(store.field, store.fields) if f.kind == kind and set(groups) <= set(f.columns.names))


def optional_fields(store: StoreTables) -> tuple[str, ...]:
    """Return the names of the fields that a clip may not have."""
    return tuple(name for name in store.fields if store.field(name).optional)


def required_fields(store: StoreTables) -> tuple[str, ...]:
    """Return the names of the fields that every clip has."""
    return tuple(name for name in store.fields if not store.field(name).optional)


def slice_length(store: StoreTables) -> int | None:
    """Return the frames of the slices, see `ClipRecord.slice_of`; None where clips are whole."""
    tables = store._tables
    return int(tables.n_frames[0]) if "slice_of" in tables.columns else None


def group_sizes(store: StoreTables) -> dict[str, int]:
    """Return the number of dancers that each group has in the source, stored or not."""
    groups = store._tables.groups
    return dict(zip(groups["id"], np.asarray(groups["n_source"]).tolist(), strict=True)) if groups else {}


def network_weights(store: StoreTables) -> dict[str, str]:
    """Return by field that a network computed: name, commit and hash of its weights, and their licence."""
    stated = {name: stated_weights(store.info, name) for name in store.fields}
    return {name: text for name, text in stated.items() if text}


def reference(store: StoreTables) -> tuple[str, str]:
    """Return the arguments of `reopen`: the path, and a hash of dataset.json."""
    return str(store.path), store._description.self_sha256


def reader_name(store: StoreTables) -> str:
    """Return the name of the reader that the dataset was built with; "" where it has no recipe."""
    return str(next(iter(store.info.get("recipe", {}).get("dataset", {})), ""))


def source_folder(store: StoreTables) -> Path | None:
    """Return the folder that the dataset was built from on this machine; None where it is unknown, or has moved."""
    try:
        place = read_json(store.path / LOCAL_FILE, _MAX_LOCAL)["source"]
        folder = Path(os.path.normpath(store.path.absolute() / place))
    except (OSError, ValueError, LookupError, TypeError, DanceDataError):
        return None
    return folder if folder.is_dir() else None


def overlay(store: StoreTables) -> SegmentOverlay:
    """Return the segments of files that were named when the dataset was opened, and notes on them."""
    return store._overlay


def require_intact(store: StoreTables, clips: Iterable[str] | None = None, sha256: FileHash = sha256_file) -> None:
    """Raise StoreError if bytes of shards or tables differ from the build's; reading rows does not compare them.

    Only the files of `clips` are read, by default all; `sha256` gives the hash of a file.
    """
    readers, files = store._shard_readers, [store._files.get(name) for name in (TABLES_FILE, SEGMENTS_FILE)]
    if clips is not None:
        numbers = set(store._tables.shard_of([store._row(clip) for clip in clips]).tolist())
        readers = tuple(readers[number] for number in sorted(numbers))
    for file in [*filter(None, files), *(reader.file for reader in readers)]:
        file.require_bytes(sha256)

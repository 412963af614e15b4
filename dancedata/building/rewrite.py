"""A dataset with other segments: the segments and dataset.json are written again, all other files stay."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from dancedata.building.out_folder import check_out, locked, new_dataset
from dancedata.core.hashing import json_sha256
from dancedata.core.segments import Segment, layer_of
from dancedata.files.atomic import dump_json, write_text
from dancedata.files.regular_file import sha256_file
from dancedata.store.dataset import Store, open_store
from dancedata.store.schema import DATASET_FILE, SEGMENTS_FILE
from dancedata.store.segments import SegmentedClip
from dancedata.store.table_writer import write_segments


def rewrite_segments(folder: Path, segments: Callable[[Store], Mapping[str, Sequence[Segment]]]) -> None:
    """Replace the segments of a dataset by those that `segments` returns for it, by clip."""
    with locked(folder):
        check_out(folder, overwrite=True)
        with open_store(folder) as store:
            by_clip = segments(store)
            with new_dataset(folder) as out:
                _link(folder, out)
                _write(out, store, by_clip)


def _link(folder: Path, out: Path) -> None:
    """Put all files of a dataset into a new folder, except its segments and dataset.json."""
    written = {DATASET_FILE, SEGMENTS_FILE}
    for path in folder.iterdir():
        if path.name in written or not path.is_file() or path.name.startswith(".dancedata"):
            continue
        with suppress(OSError):  # a file system without links
            os.link(path, out / path.name)
            continue
        shutil.copyfile(path, out / path.name)


def _write(out: Path, store: Store, by_clip: Mapping[str, Sequence[Segment]]) -> None:
    splits = [
        [SegmentedClip(clip.id, clip.n_frames, by_clip[clip.id]) for clip in store.clips(split)]
        for split in store.splits
    ]
    layers = sorted({segment.layer for segments in by_clip.values() for segment in segments}, key=repr)
    document = {key: value for key, value in store.info.items() if key not in ("self_sha256", "layers")}
    path = out / SEGMENTS_FILE
    entries = write_segments(path, store.grid, splits, layers)
    counts = {layer_of(entry): entry["empty"] for entry in store.info.get("layers", ())}
    for layer, entry in zip(layers, entries, strict=True):
        entry["empty"] = max(entry["empty"], counts.get(layer, 0))  # a file of --to does not have those of the build
    document |= {"layers": entries} if entries else {}
    document["files"] = {name: entry for name, entry in document["files"].items() if name != SEGMENTS_FILE}
    if path.exists():
        document["files"][SEGMENTS_FILE] = {"size": path.stat().st_size, "sha256": sha256_file(path)}
    document["self_sha256"] = json_sha256(document)
    write_text(out / DATASET_FILE, dump_json(document))

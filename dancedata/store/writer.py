"""write_store: shards, tables, statistics, side files, and dataset.json last."""

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from dancedata.core.clip import Reject
from dancedata.core.errors import StoreError
from dancedata.core.hashing import json_sha256
from dancedata.files.atomic import dump_json, dump_lines, write_text
from dancedata.files.regular_file import sha256_file
from dancedata.store.schema import (
    CARD_FILE,
    DATASET_FILE,
    FORMAT,
    REJECTS_FILE,
    SEGMENTS_FILE,
    SIDE_FILES,
    STATS_FILE,
    TABLES_FILE,
    StoreHeader,
)
from dancedata.store.segments import quality_segments
from dancedata.store.shard_plan import ShardPlan, plan_shards
from dancedata.store.shard_writer import written_shard
from dancedata.store.songs import songs_of, split_counts
from dancedata.store.stats import compute_stats
from dancedata.store.stored_clip import StoredClip
from dancedata.store.table_writer import TablePlan, write_tables


def write_store(
    out: Path,
    header: StoreHeader,
    clips: Sequence[StoredClip],
    *,
    rejects: Sequence[Reject] = (),
    quality: Sequence[Mapping[str, Any]] = (),
    shard_bytes: int = 256 * 2**20,
    card: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a dataset into a folder; equal input gives equal bytes.

    Parameters
    ----------
    out
        Existing folder without a finished dataset. Files that an interrupted run left there are overwritten.
    header
        Fields, windows and frame rate of the store.
    clips
        In any order. Their arrays are loaded one at a time.
    rejects, quality
        For rejects.jsonl, in this order; quality flags of the clips, for the layers "quality" of their segments.
    shard_bytes
        A shard takes clips while its rows stay within this many bytes; it has at least one clip.
    card, progress
        Text of README.md; called with (clips written, number of clips) after each clip.

    Raises
    ------
    StoreError
        For input that the format cannot hold, values that are not finite, and a folder that cannot be written to.
    """
    _check_folder(out)
    flags = quality_segments(quality, {clip.id: clip.n_frames for clip in clips}, header.grid)
    clips = [replace(c, segments=(*c.segments, *flags[c.id])) if c.id in flags else c for c in clips]
    plans = plan_shards(header, clips, shard_bytes)
    tables = TablePlan.of(header, clips)
    document = _with_meta(header, _describe(header, plans, tables))
    done = itertools.count(1)

    def advance() -> None:
        if progress is not None:
            progress(next(done), len(clips))

    try:
        with (
            ThreadPoolExecutor(max_workers=1, thread_name_prefix="publishing") as publishing,
            ThreadPoolExecutor(max_workers=1, thread_name_prefix="hashing") as hashing,
        ):
            # A shard is flushed and hashed while the next one is written, or the statistics are computed; at most one
            # waits for either.
            published: list[Future[None]] = []
            entries: list[Future[dict[str, Any]]] = []
            for plan in plans:
                with ExitStack() as shard:
                    shard.enter_context(written_shard(out, plan, advance))
                    if entries:
                        entries[-1].result()
                    published.append(publishing.submit(shard.pop_all().close))
                entries.append(hashing.submit(_describe_shard, out, plan, published[-1]))
            published[-1].result()
            stats = compute_stats(out, header, plans)
            document["shards"] = [entry.result() for entry in entries]
        layers = write_tables(out, tables, plans)
        document |= {"layers": layers} if layers else {}
        write_text(out / STATS_FILE, dump_json(stats))
        write_text(out / REJECTS_FILE, dump_lines([r.to_json() for r in rejects]))
        write_text(out / CARD_FILE, card)
        written = (TABLES_FILE, *([SEGMENTS_FILE] if (out / SEGMENTS_FILE).exists() else []), *SIDE_FILES)
        document["files"] = {name: _describe_file(out / name) for name in written}
        document["self_sha256"] = json_sha256(document)
        write_text(out / DATASET_FILE, dump_json(document))
    except OSError as error:
        raise StoreError(
            "the dataset cannot be written",
            where=str(out),
            found=str(error),
            fix="check that the folder is writable and the disk has space, then build again",
        ) from error


def _check_folder(out: Path) -> None:
    if not out.is_dir():
        raise StoreError("the folder to write to does not exist", where=str(out))
    if (out / DATASET_FILE).exists():
        raise StoreError("the folder holds a finished dataset already", where=str(out),
                         fix="write to another folder, or remove it first")  # fmt: skip


def _describe(header: StoreHeader, plans: Sequence[ShardPlan], tables: TablePlan) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "fps": str(header.fps),
        "windows": {"length": header.length, "stride": header.stride},
        "fields": [f.to_json() for f in header.fields],
        "skeleton": header.skeleton.to_json(),
        **({"licences": [licence.to_json() for licence in tables.licences]} if tables.licences else {}),
        "splits": _count(header, plans),
    }


def _count(header: StoreHeader, plans: Sequence[ShardPlan]) -> dict[str, dict[str, int | float]]:
    songs = songs_of([c for p in plans for c in p.clips])
    counts = {}
    for split in dict.fromkeys(p.split for p in plans):
        clips = [c for p in plans if p.split == split for c in p.clips]
        counts[split] = split_counts(clips, sum(len(c.starts) for c in clips), songs, header.grid)
    return counts


def _with_meta(header: StoreHeader, document: dict[str, Any]) -> dict[str, Any]:
    """Return dataset.json with the caller's keys; StoreError if one of them is a key of the format."""
    reserved = {*document, "shards", "layers", "licences", "files", "self_sha256"}
    clashing = sorted(reserved & set(header.meta))
    if clashing:
        raise StoreError("meta has keys that the format uses itself", found=", ".join(clashing))
    try:
        meta = json.loads(json.dumps(dict(header.meta), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise StoreError("meta is not valid JSON", found=str(error)) from error
    return {**document, **meta}


def _describe_shard(out: Path, plan: ShardPlan, published: Future[None]) -> dict[str, Any]:
    published.result()
    return {
        "file": plan.file,
        "split": plan.split,
        **_describe_file(out / plan.file),
        "clips": len(plan.clips),
        "windows": sum(len(c.starts) for c in plan.clips),
        "fields": {f.name: [plan.first_bytes[f.name], plan.rows[f.name]] for f in plan.header.fields},
    }


def _describe_file(path: Path) -> dict[str, Any]:
    return {"size": path.stat().st_size, "sha256": sha256_file(path)}

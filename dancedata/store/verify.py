"""verify_store: checks that a built dataset is complete and undamaged."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dancedata.core.errors import StoreError
from dancedata.core.text import listed, shown
from dancedata.files.addresses import local_folder, origin_of, require_whole
from dancedata.files.atomic import PREFIX
from dancedata.files.regular_file import read_regular, sha256_file
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.columns import MAX_ROWS
from dancedata.store.dataset import Store
from dancedata.store.dataset_json import MAX_BYTES, Description, json_stats, load_description, require_sealed
from dancedata.store.listed_file import ListedFile, hdf5_files
from dancedata.store.schema import (
    CARD_FILE,
    DATASET_FILE,
    SEGMENTS_FILE,
    STATS_FILE,
    TABLES_FILE,
    is_shard_name,
    shard_name,
)
from dancedata.store.songs import songs_of, split_counts
from dancedata.store.stats import row_stats
from dancedata.store.verify_shard import Problem, verify_shard, verify_tables, verify_values

_LEFTOVER = re.compile(r"\.tmp$|\.part$|~$")
#: Most names in one message.
_SHOWN = 10


def verify_store(path: str | Path) -> list[Problem]:
    """Check a built dataset in bounded memory, independent of its size.

    The size and sha256 of every file are checked first: a shard that differs is not parsed. Then the layout (names,
    dtypes, shapes, alignment), bounds of all rows and windows, finiteness of all values, counts, and clips
    in several splits. Songs that splits share are what ``dancedata check`` finds beside.

    Parameters
    ----------
    path
        Folder of the dataset, or its address: then all its files are fetched first.

    Returns
    -------
    list of Problem
        "error": the dataset is damaged, or a clip is in two splits; "note": what else should be known. A damaged
        dataset never raises an error.

    Examples
    --------
    >>> from dancedata.store import verify_store
    >>> [problem for problem in verify_store("data/aistpp") if problem.severity == "error"]
    []
    """
    folder = local_folder(path)
    try:
        description = load_description(folder)
        require_whole(folder)
    except StoreError as error:
        return [Problem("error", str(folder / DATASET_FILE), str(error))]
    problems = [*_check_document(folder, description), *_check_side_files(folder, description)]
    damaged = set()
    for entry in hdf5_files(description):
        path = folder / entry.file
        message = _compare_file(path, {"size": entry.size, "sha256": entry.sha256})
        if message:
            problems.append(Problem("error", str(path), message))
            damaged.add(entry.file)
    records: list[ClipRecord] = []
    if not damaged & {TABLES_FILE, SEGMENTS_FILE}:
        files = {e.file: ListedFile(folder / e.file, e.size, e.sha256, None) for e in hdf5_files(description)}
        with Store(folder, description, files) as store:
            in_tables, numbers = list(verify_tables(store, description)), dict[str, Any]()
            problems += in_tables
            sound: list[int] = []  # a shard that differs is not parsed
            for number, entry in enumerate(description.shards):
                in_shard = list(verify_shard(store, description, number)) if entry.file not in damaged else ()
                problems += in_shard
                sound += [number] if entry.file not in damaged and not in_shard else []
            if not in_tables:
                records += store._tables.records()
                for f in description.fields:
                    numbers[f.name] = row_stats(f, verify_values(store, f, sound, problems))
            # In a damaged dataset, counts would only repeat the same problems.
            if not any(p.severity == "error" for p in problems):
                problems += _check_counts(folder, description, records)
                problems += _check_stride(store)
                problems += _check_numbers(store, numbers) if STATS_FILE in description.files else ()
    problems += _check_copies(folder, records)
    problems += _find_unlisted_files(folder, description)
    return problems


def _check_document(folder: Path, description: Description) -> Iterator[Problem]:
    where = str(folder / DATASET_FILE)
    try:
        require_sealed(description, folder)
    except StoreError as error:
        yield Problem("error", where, str(error))
    if not description.shards:
        yield Problem("error", where, "it does not list any shards")
    by_split: dict[str, list[str]] = defaultdict(list)
    for entry in description.shards:
        by_split[entry.split].append(entry.file)
    for split, files in by_split.items():
        names = [shard_name(split, i, len(files)) for i in range(len(files))]
        if files != names:
            yield Problem(
                "error", where, f"shards of {split} are not {_list(names)}, in this order, but {_list(files)}"
            )
    if set(description.meta["splits"]) != set(by_split):
        yield Problem("error", where, f"splits are not those of the shards: {', '.join(by_split)}")


def _check_side_files(folder: Path, description: Description) -> Iterator[Problem]:
    for name, entry in description.files.items():
        if name in (TABLES_FILE, SEGMENTS_FILE):
            continue  # compared with the shards
        # The card may be edited by hand.
        severity: Literal["error", "note"] = "note" if name == CARD_FILE else "error"
        if Path(name).name != name:
            yield Problem("error", str(folder / DATASET_FILE), f"{name!r} is not a file of the dataset")
            continue
        if name == CARD_FILE and origin_of(folder) is not None:
            continue  # not fetched
        message = _compare_file(folder / name, entry)
        if message:
            yield Problem(severity, str(folder / name), message)
        elif name == STATS_FILE:
            yield from _check_stats(folder / name, description)


def _check_stats(path: Path, description: Description) -> Iterator[Problem]:
    try:
        stats = json_stats(read_regular(path, MAX_BYTES).decode("utf-8"))
        fields, n_windows = list(stats["fields"]), stats["windows"]
        stored = sum(shard.windows for shard in description.shards if shard.split == "train")
        if n_windows != stored:
            yield Problem("error", str(path), f"it is of {shown(n_windows, 60)} windows, not {stored}")
    except (ValueError, KeyError, OSError) as error:
        yield Problem("error", str(path), f"it cannot be read: {shown(error)}")
        return
    expected = [f.name for f in description.fields] if n_windows else []
    # An optional field that no train clip has is not there.
    expected = [f.name for f in description.fields if f.name in expected and (not f.optional or f.name in fields)]
    if sorted(fields) != sorted(expected):
        yield Problem("error", str(path), f"it has fields {_list(fields)}, not {_list(expected)}")


def _check_numbers(store: Store, numbers: Mapping[str, Mapping[str, Any]]) -> Iterator[Problem]:
    """Compare stats.json with the rows; of rows that clips share, how often each counts is not stored."""
    for name, stated in store.stats["fields"].items():
        compared = numbers[name] if store.field(name).per_clip else ("min", "max", "scaler")
        computed = {key: value for key, value in numbers[name].items() if key in compared}
        wrong = [key for key, value in computed.items() if not _is_near(stated.get(key), value, computed)]
        if wrong:
            yield Problem("error", str(store.path / STATS_FILE), f"{name}: not the {_list(wrong)} of the rows")


def _is_near(stated: Any, value: Any, numbers: Mapping[str, Any]) -> bool:
    if isinstance(value, dict):
        return isinstance(stated, dict) and all(_is_near(stated.get(key), v, numbers) for key, v in value.items())
    if stated == value:
        return True
    try:
        size = np.maximum(np.abs(numbers["min"]), np.abs(numbers["max"]))
        return np.shape(stated) == np.shape(value) and np.allclose(stated, value, rtol=1e-6, atol=1e-6 * size)
    except (TypeError, ValueError):  # no numbers
        return False


def _compare_file(path: Path, entry: Mapping[str, Any]) -> str:
    """Return in what a file differs from its entry, by size first and then by hash; "" if it does not."""
    if not path.is_file():
        return "it is missing"
    try:
        size = path.stat().st_size
        if size != entry["size"]:
            return f"it has {size} bytes, in dataset.json {entry['size']}"
        sha256 = sha256_file(path)
    except OSError as error:
        return f"it cannot be read: {error}"
    if sha256 != entry["sha256"]:
        listed_sha256 = str(entry["sha256"])
        return f"its sha256 is {sha256[:12]}..., in dataset.json {listed_sha256[:12]}...: bytes have changed"
    return ""


def _check_counts(folder: Path, description: Description, records: Sequence[ClipRecord]) -> Iterator[Problem]:
    where = str(folder / DATASET_FILE)
    songs = songs_of(records)
    for split, counts in description.meta["splits"].items():
        n_windows = sum(shard.windows for shard in description.shards if shard.split == split)
        actual = split_counts([r for r in records if r.split == split], n_windows, songs, description.grid)
        for name, value in actual.items():
            if counts.get(name) != value:
                yield Problem("error", where, f"splits: {split} has {value} {name}, not {counts.get(name)}")


def _check_stride(store: Store) -> Iterator[Problem]:
    """Find a stride smaller than between any windows of a clip: readers take it for windows of another length."""
    clip, start = store._tables.window_clip, store._tables.window_start
    apart, stride = np.diff(start)[clip[1:] == clip[:-1]].min(initial=MAX_ROWS), store._description.stride
    if stride < apart < MAX_ROWS:
        message = f"windows: the stride is {stride} frames, and the windows of clips are {apart} apart or more"
        yield Problem("note", str(store.path / DATASET_FILE), message)


def _check_copies(folder: Path, records: Sequence[ClipRecord]) -> Iterator[Problem]:
    times = Counter(r.id for r in records)
    for clip in (c for c, n in times.items() if n > 1):
        splits = sorted({r.split for r in records if r.id == clip})
        yield Problem("error", str(folder), f"clip {clip} occurs {times[clip]} times, in {', '.join(splits)}")
    split_of = {r.id: r.split for r in records}
    for record in records:
        origin = split_of.get(record.source, record.split)
        if origin != record.split:
            yield Problem(
                "error", str(folder), f"clip {record.id} of {record.split} is a copy of {record.source} of {origin}"
            )


def _find_unlisted_files(folder: Path, description: Description) -> Iterator[Problem]:
    shards = {entry.file for entry in hdf5_files(description)}
    for path in sorted(folder.iterdir()):
        if path.name in shards:
            continue
        if is_shard_name(path.name) or path.name.startswith(PREFIX) or _LEFTOVER.search(path.name):
            yield Problem("note", str(path), "a file that dataset.json does not list; readers ignore it")


def _list(names: Sequence[str]) -> str:
    return listed(names, _SHOWN) or "none"

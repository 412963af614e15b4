"""Reads dataset.json and says clearly what is wrong with it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from dancedata.core.atomic import OWN
from dancedata.core.errors import DanceDataError, StoreError
from dancedata.core.grid import as_rate
from dancedata.core.hashing import json_sha256
from dancedata.core.skeleton import Skeleton
from dancedata.store.schema import DATASET_FILE, FORMAT, Field, is_shard_name

REBUILD = "build the dataset again"
#: Larger descriptions are none.
MAX_BYTES = 1 << 26


@dataclass(frozen=True)
class ShardEntry:
    """What dataset.json says of a shard."""

    file: str
    split: str
    size: int
    sha256: str
    clips: int
    windows: int


@dataclass(frozen=True)
class Description:
    """dataset.json, parsed."""

    meta: Mapping[str, Any]
    scope: str
    fps: Fraction
    length: int
    stride: int
    order: str
    fields: tuple[Field, ...]
    skeleton: Skeleton
    shards: tuple[ShardEntry, ...]
    files: Mapping[str, Mapping[str, Any]]


def load_description(folder: Path) -> Description:
    """Read ``folder / dataset.json``.

    Raises
    ------
    StoreError
        If there is none, saying what is there instead, if it is damaged, or of another format version.
    """
    path = folder / DATASET_FILE
    try:
        if path.stat().st_size > MAX_BYTES:
            found = f"{path.stat().st_size:,} bytes"
            raise StoreError("dataset.json is too large", where=str(path), found=found, allowed=f"{MAX_BYTES:,}")
        text = path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError) as error:
        raise StoreError(
            "there is no finished dataset",
            where=str(folder),
            found=describe_folder(folder),
            allowed="a folder with dataset.json in it",
            fix="give the folder that dancedata build wrote to; if a build was interrupted, run it again",
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise StoreError("dataset.json cannot be read", where=str(path), found=str(error), fix=REBUILD) from error
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise StoreError("dataset.json is no JSON", where=str(path), found=str(error), fix=REBUILD) from error
    if not isinstance(document, dict) or "format" not in document:
        raise StoreError("dataset.json is not of a dancedata dataset", where=str(path), found="no key 'format'")
    if document["format"] != FORMAT:
        raise StoreError(
            "the dataset has another format version",
            where=str(path),
            found=document["format"],
            allowed=FORMAT,
            fix="use the dancedata version that built it, or build it again",
        )
    return _parse(document, path)


def self_hash(document: Mapping[str, Any]) -> str:
    """Hash dataset.json without the hash it holds."""
    return json_sha256({k: v for k, v in document.items() if k != "self_sha256"})


def json_lines(text: str) -> list[Any]:
    """Parse one object a line; raises ValueError."""
    # Not splitlines: it also splits at separators that may stand inside a JSON string.
    return [_object(json.loads(line)) for line in text.split("\n") if line]


def _object(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"a {type(value).__name__} where an object is expected")
    return value


def json_stats(text: str) -> dict[str, Any]:
    """Parse stats.json; raises ValueError."""
    stats = _object(json.loads(text))
    _object(stats.get("fields"))
    return stats


def describe_folder(folder: Path) -> str:
    """Say in a few words what a folder holds, for error texts."""
    if not folder.exists():
        return "no such folder"
    if not folder.is_dir():
        return "a file"
    names = sorted(p.name for p in folder.iterdir())
    if not names:
        return "an empty folder"
    shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    if any(name.startswith(OWN) for name in names):
        return shown + " (an unfinished build)"
    return shown + (" (shards without dataset.json: an unfinished build)" if any(map(is_shard_name, names)) else "")


def _parse(document: dict[str, Any], path: Path) -> Description:
    try:
        windows = document["windows"]
        if not document["fields"]:
            raise ValueError("no field")
        return Description(
            meta=document,
            scope=_one_of(document["scope"], ("track", "window")),
            fps=as_rate(document["fps"]),
            length=_whole(windows["length"]),
            stride=_whole(windows["stride"]),
            order=_one_of(windows["order"], ("time", "name")),
            fields=tuple(Field.from_json(f) for f in document["fields"]),
            skeleton=Skeleton.from_json(document["skeleton"]),
            shards=tuple(_shard(s) for s in document["shards"]),
            files={str(k): {"size": v["size"], "sha256": v["sha256"]} for k, v in document["files"].items()},
        )
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, DanceDataError) as error:
        raise StoreError(
            "dataset.json lacks something or has something wrong",
            where=str(path),
            found=f"{type(error).__name__}: {error}",
            fix=REBUILD,
        ) from error


def _shard(entry: Mapping[str, Any]) -> ShardEntry:
    file = entry["file"]
    if not isinstance(file, str) or not is_shard_name(file) or Path(file).name != file:
        raise ValueError(f"{file!r} is no shard's name")
    numbers = {name: _whole(entry[name]) for name in ("size", "clips", "windows")}
    return ShardEntry(file=file, split=str(entry["split"]), sha256=str(entry["sha256"]), **numbers)


def _whole(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{value!r} is no whole number")
    return value


def _one_of(value: Any, allowed: tuple[str, ...]) -> str:
    if value not in allowed:
        raise ValueError(f"{value!r} is none of {', '.join(allowed)}")
    return str(value)

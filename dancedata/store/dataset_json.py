"""Reads and checks dataset.json and the JSON files next to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dancedata.core.arguments import whole
from dancedata.core.errors import DanceDataError, StoreError
from dancedata.core.grid import FrameGrid, as_rate
from dancedata.core.hashing import canonical_json, self_hash
from dancedata.core.segments import Layer, layer_of
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import listed, quoted, shown
from dancedata.files.addresses import origin_of
from dancedata.files.atomic import PREFIX
from dancedata.files.listing import FileEntry
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import parse_json
from dancedata.store.schema import DATASET_FILE, FORMAT, PUBLICATION_FILE, TABLES_FILE, Field, is_shard_name

REBUILD = "build the dataset again"
#: Largest dataset.json and stats.json, bytes.
MAX_BYTES = 1 << 26
#: Largest recipe with all its defaults, characters.
MAX_RECIPE = 1 << 17
#: Largest whole number, and largest number of any kind, that are accepted.
_LARGEST = 1 << 53
_LARGE = 1e300
#: Most frames after which frames and rows may coincide: this multiple of a frame number fits into 64 bits.
_MAX_PERIOD = 1 << 31
#: Largest rejects.jsonl, bytes.
MAX_LINES_BYTES = 1 << 28


@dataclass(frozen=True)
class ShardEntry(FileEntry):
    """A shard in dataset.json: first byte and number of rows by field."""

    split: str
    clips: int
    windows: int
    fields: Mapping[str, tuple[int, int]]


class SplitRows(NamedTuple):
    """Clips and windows of a split in the tables, and its shards: splits follow one another, each in one piece."""

    clips: slice
    windows: slice
    shards: slice


@dataclass(frozen=True)
class Description:
    """dataset.json, parsed."""

    meta: Mapping[str, Any]
    fps: Fraction
    length: int
    stride: int
    fields: tuple[Field, ...]
    skeleton: Skeleton
    shards: tuple[ShardEntry, ...]
    files: Mapping[str, Mapping[str, Any]]
    layers: tuple[Layer, ...]

    @cached_property
    def splits(self) -> Mapping[str, SplitRows]:
        """Rows of the splits, in the order of their shards."""
        ends = np.cumsum([(shard.clips, shard.windows, 1) for shard in self.shards], axis=0).tolist()
        splits, begin = dict[str, SplitRows](), [0, 0, 0]
        for shard, end in zip(self.shards, ends, strict=True):
            stored = splits.get(shard.split)
            begin = begin if stored is None else [rows.start for rows in stored]
            splits[shard.split], begin = SplitRows(*map(slice, begin, end)), end
        return splits

    @cached_property
    def grid(self) -> FrameGrid:
        """The grid of the store's frames."""
        return FrameGrid(self.fps)

    @cached_property
    def self_sha256(self) -> str:
        """The hash of the document, which its key self_sha256 states."""
        return self_hash(self.meta)


def load_description(folder: Path) -> Description:
    """Read ``folder / dataset.json``; StoreError if it is missing, damaged, or of another format version."""
    path = folder / DATASET_FILE
    try:
        text = read_regular(path, MAX_BYTES).decode("utf-8")
    except (FileNotFoundError, NotADirectoryError) as error:
        if (folder / PUBLICATION_FILE).exists():
            place = origin_of(folder)
            raise StoreError(
                "this publication has a recipe and no data",
                where=str(folder) if place is None else place.address,
                fix="build it from your own copy of the source: dancedata build "
                f"{folder if place is None else place.address} SOURCE --out DIR",
            ) from error
        raise StoreError("there is no finished dataset", where=str(folder), found=describe_folder(folder),
                         allowed="a folder with dataset.json in it",
                         fix=f"give the folder that dancedata build wrote to; {INTERRUPTED}") from error  # fmt: skip
    except (OSError, UnicodeDecodeError) as error:
        raise StoreError("dataset.json cannot be read", where=str(path), found=str(error), fix=REBUILD) from error
    try:
        document = parse_json(text)
    except ValueError as error:
        raise StoreError("dataset.json is not valid JSON", where=str(path), found=str(error), fix=REBUILD) from error
    if not isinstance(document, dict) or "format" not in document:
        raise StoreError(
            "dataset.json does not describe a dancedata dataset", where=str(path), found="no key 'format'"
        )
    if document["format"] != FORMAT:
        raise StoreError("the dataset has another format version", where=str(path), found=document["format"],
                         allowed=FORMAT,
                         fix="use the dancedata version that built it, or build it again")  # fmt: skip
    return _parse(document, path)


def require_sealed(description: Description, folder: Path) -> None:
    """Raise StoreError unless `self_sha256` is the hash of dataset.json: else it was changed after the build."""
    seal, content = description.meta.get("self_sha256"), description.self_sha256
    if seal != content:
        raise StoreError(
            "dataset.json was changed after the build: its content does not match its self_sha256",
            where=str(folder / DATASET_FILE),
            found=f"self_sha256 {quoted(seal)}",
            allowed=content,
            fix=f"copy the file again, or {REBUILD}; if the change is your own, set self_sha256 to the allowed value",
        )


def json_rejects(text: str) -> list[dict[str, Any]]:
    """Parse rejects.jsonl; raises ValueError."""
    return _json_lines(text, ("reason",), _REJECT)


#: Types of the values of rejects and quality flags.
_REJECT = {**dict.fromkeys(("reason", "clip", "file", "detail", "music", "fix"), str), "window": int, "numbers": dict}
_FLAG = {"clip": str, "kind": str, "frame": int, "value": float, "unit": str, "joint": str}


def checked_flag(row: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Return a quality flag; ValueError for one whose values are of other types."""
    _check_types(row, where, ("clip",), _FLAG)
    return row


def _json_lines(text: str, needed: Sequence[str], types: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Parse one object per line; the values of these keys have to be of these types."""
    # Not splitlines: it also splits at separators that are allowed inside a JSON string.
    rows = [json_object(line) for line in text.split("\n") if line]
    for number, row in enumerate(rows, start=1):
        _check_types(row, f"line {number}", needed, types)
    return rows


def _check_types(row: Mapping[str, Any], where: str, needed: Sequence[str], types: Mapping[str, Any]) -> None:
    for key in {*needed, *(types.keys() & row)}:
        good = _is_number(row.get(key)) if types[key] is float else type(row.get(key)) is types[key]
        if not good:
            raise ValueError(f"{where}: {key} is {quoted(row.get(key), 60)}")


def json_object(text: str) -> dict[str, Any]:
    """Parse a JSON object; raises ValueError."""
    return _object(parse_json(text))


def _object(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"a {type(value).__name__} where an object is expected")
    return value


def json_stats(text: str) -> dict[str, Any]:
    """Parse stats.json; raises ValueError."""
    stats = json_object(text)
    for numbers in _object(stats.get("fields")).values():
        _object(numbers)
    return stats


#: What to do about a folder that holds a part of a dataset, or nothing.
INTERRUPTED = "if a build was interrupted, run it again"


def describe_folder(folder: Path) -> str:
    """Describe the content of a folder in a few words, for error messages."""
    if not folder.exists():
        return "no such folder"
    if not folder.is_dir():
        return "a file"
    names = sorted(p.name for p in folder.iterdir())
    if not names:
        return "an empty folder"
    text = listed(names, 8)
    if any(name.startswith(PREFIX) for name in names):
        return text + " (an unfinished build)"
    return text + (" (shards without dataset.json: an unfinished build)" if any(map(is_shard_name, names)) else "")


def _parse(document: dict[str, Any], path: Path) -> Description:
    try:
        windows = document["windows"]
        if not document["fields"]:
            raise ValueError("there are no fields")
        _check_about(document)
        description = Description(
            meta=document,
            fps=as_rate(document["fps"]),
            length=whole("windows: length", windows["length"], 1, _LARGEST),
            stride=whole("windows: stride", windows["stride"], 1, _LARGEST),
            fields=tuple(Field.from_json(f) for f in document["fields"]),
            skeleton=Skeleton.from_json(document["skeleton"]),
            shards=tuple(_shard(s) for s in document["shards"]),
            files={str(k): _file(v) for k, v in document["files"].items()},
            layers=tuple(layer_of(entry) for entry in document.get("layers", ())),
        )
        _check_rates(description)
        _check_shards(description)
        return description
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, DanceDataError) as error:
        raise StoreError(
            "dataset.json is incomplete or has a wrong value", where=str(path), found=shown(error), fix=REBUILD
        ) from error


#: Types of the keys that commands show; all but `splits` are optional.
_ABOUT: dict[str, type] = {
    **dict.fromkeys(("name", "licence", "citation", "self_sha256"), str),
    **dict.fromkeys(
        ("recipe", "source", "splits", "genre_ids", "versions", "encoders"),
        dict,
    ),
}


def _check_rates(description: Description) -> None:
    """Raise ValueError for rates between which 64-bit frame and row numbers cannot be converted."""
    for field in description.fields:
        if max(description.grid.common_period(field.grid)) > _MAX_PERIOD:
            rates = f"{shown(field.rate)} rows per second, at {shown(description.fps)} frames"
            raise ValueError(f"field {shown(field.name)} has {rates}")


def _check_about(document: Mapping[str, Any]) -> None:
    """Raise ValueError for a value whose type a build does not write: code that shows it relies on the type."""
    for key, kind in _ABOUT.items():
        if not isinstance(document.get(key, kind()), kind):
            raise ValueError(f"{key} is a {type(document[key]).__name__}, not a {kind.__name__}")
    if len(canonical_json(document.get("recipe", {}))) > MAX_RECIPE:
        raise ValueError(f"a recipe of more than {MAX_RECIPE:,} characters")
    for split, counts in document["splits"].items():
        for name in ("clips", "windows", "frames", "songs", *(["groups"] if "groups" in counts else [])):
            whole(name, counts[name], most=_LARGEST)
        if not _is_number(counts["hours"]):
            raise ValueError(f"{shown(split)} has {quoted(counts['hours'])} hours")
    for entry in document.get("licences", []):
        if not isinstance(entry, dict) or not all(isinstance(entry.get(k), str) for k in ("licence", "citation")):
            raise ValueError("licences are not a list of licence and citation")
    if not all(
        isinstance(document.get("source", {}).get(key, ""), str) for key in ("reader", "sha256", "split_rule")
    ):
        raise ValueError("reader, sha256 or split_rule of the source is not a text")
    notes = document.get("source", {}).get("notes", [])
    if not isinstance(notes, list) or not all(isinstance(note, str) for note in notes):
        raise ValueError("the notes on the source are not a list of texts")


def field_weights(document: Mapping[str, Any], field: str) -> str:
    """Return name, commit, hash and licence of the weights that computed a field; "" where none are stated."""
    encoder, recipe = document.get("encoders", {}).get(field), document.get("recipe", {}).get("audio")
    encoder = encoder if isinstance(encoder, Mapping) else {}
    keys = recipe.get(field) if isinstance(recipe, Mapping) else None
    hashes = [v for k, v in keys.items() if str(k).endswith("_sha256") and v] if isinstance(keys, Mapping) else []
    parts = {
        "": encoder.get("model"),
        "revision ": encoder.get("revision"),
        "sha256 ": encoder.get("sha256") or next(iter(hashes), None),
        "licence: ": encoder.get("licence"),
    }
    return ", ".join(f"{name}{shown(value, 600)}" for name, value in parts.items() if value)


def _shard(entry: Mapping[str, Any]) -> ShardEntry:
    file = entry["file"]
    if not isinstance(file, str) or not is_shard_name(file) or Path(file).name != file:
        raise ValueError(f"{quoted(file)} is not the name of a shard")
    numbers = {name: whole(name, entry[name], most=_LARGEST) for name in ("size", "clips", "windows")}
    fields = {
        str(f): (whole(f, first, most=_LARGEST), whole(f, n, most=_LARGEST))
        for f, (first, n) in entry["fields"].items()
    }
    return ShardEntry(file=file, split=str(entry["split"]), sha256=str(entry["sha256"]), fields=fields, **numbers)


def _file(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {"size": whole("size", entry["size"], most=_LARGEST), "sha256": str(entry["sha256"])}


def _check_shards(description: Description) -> None:
    names = {f.name for f in description.fields}
    for shard in description.shards:
        if set(shard.fields) != names:
            raise ValueError(f"{shown(shard.file)} does not state the rows of every field")
    if len(list(groupby(s.split for s in description.shards))) != len(description.splits):
        raise ValueError("the shards of a split are not neighbours")
    if TABLES_FILE not in description.files:
        raise ValueError(f"it does not list {TABLES_FILE}")


def _is_number(value: Any) -> bool:
    """Whether it is a number that a float can hold."""
    return type(value) in (int, float) and abs(value) < _LARGE

"""Arguments of readers as plain data, for YAML, JSON and checkpoints; and those of published trainers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import shown
from dancedata.torch.options import Dancers, Item, Primitives, Relative, Scale, Segments, Select, Text, Value, Windows

_ITEMS: Mapping[str, type[Value]] = {cls.__name__.lower(): cls for cls in (Relative, Primitives, Text, Segments)}
_ARGUMENTS: Mapping[str, type[Value]] = {"windows": Windows, "select": Select, "scale": Scale, "dancers": Dancers}


def to_plain(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments of a reader as plain data, for YAML, JSON and checkpoints.

    ``{"fields": ("edge151", Text("style")), "windows": Windows(length=150)}`` is ``{"fields": ["edge151", {"text":
    {"layer": "style"}}], "windows": {"length": 150}}``. UsageError for what is not data, such as a plug-in object.
    """
    return {name: _plain(name, value) for name, value in arguments.items()}


def from_plain(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a reader that plain data of `to_plain` stand for; UsageError for unknown parameters."""
    if not isinstance(arguments, Mapping):
        raise UsageError("arguments of a reader are a mapping", found=shown(arguments))
    values = dict(arguments)
    for name, cls in _ARGUMENTS.items():
        value = values.get(name)
        if isinstance(value, Mapping) and (
            cls is not Scale or not value or value.keys() & {f.name for f in fields(Scale)}
        ):
            values[name] = _value_of(cls, value)
    if isinstance(values.get("fields"), list | tuple):
        values["fields"] = tuple(_item(entry) for entry in values["fields"])
    return values


def _item(entry: Any) -> Item:
    if not isinstance(entry, Mapping):
        return entry  # type: ignore[no-any-return]  # a name; readers check it
    for name, parameters in entry.items() if len(entry) == 1 else ():
        if name in _ITEMS:
            return _value_of(_ITEMS[name], parameters or {})  # type: ignore[return-value]
    raise UsageError("an entry of fields is neither a name nor one of the mappings", found=repr(entry),
                     allowed=", ".join(f"{{{kind}: ...}}" for kind in _ITEMS))  # fmt: skip


def _value_of(cls: type[Value], plain: Any) -> Value:
    parameters = {f.name: f for f in fields(cls)}
    if not isinstance(plain, Mapping):
        raise UsageError(f"{cls.__name__} takes a mapping of its parameters", found=shown(plain),
                         allowed=", ".join(parameters))  # fmt: skip
    for name in plain:
        if name not in parameters:
            raise UsageError(f"{cls.__name__} has no parameter {name!r}", fix=did_you_mean(str(name), parameters))
    try:
        return cls(**plain)
    except TypeError as error:
        raise UsageError(f"{cls.__name__} lacks a parameter", found=str(error)) from error


def _plain(where: str, value: Any) -> Any:
    if isinstance(value, Value):
        tag = type(value).__name__.lower()
        plain = {name: _plain(f"{type(value).__name__}.{name}", entry) for name, entry in value.stated()}
        return {tag: plain} if tag in _ITEMS else plain
    if isinstance(value, Mapping):
        return {str(name): _plain(f"{where}.{name}", entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(where, entry) for entry in value]
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, str | int | float):
        return value
    raise UsageError(f"{where} is not plain data", found=shown(value),
                     fix="name it: plug-ins by {NAME: parameters}, scalers by the file of save(FILE)")  # fmt: skip


def _lodge(length: int, stride: int) -> dict[str, Any]:
    return {
        "fields": ("lodge139", "librosa35"),
        "windows": Windows(length=length, stride=stride, fps=30, trim=True),
        "select": Select(ignore=("ignored",), protocol="cross_genre", filter={"movement": {"field": "lodge139"}}),
        "scale": Scale(clamp=True),
    }


#: Arguments of readers as published trainers have them: ``WindowDataset(OUT, **PRESETS["edge"])``; others take their
#: place, ``**PRESETS["edge"] | {"scale": None}``.
PRESETS: Mapping[str, dict[str, Any]] = {
    # EDGE (Tseng et al. 2023, data/slice.py): 5 s every 0.5 s.
    "edge": {
        "fields": ("edge151", "librosa35"),
        "windows": Windows(length_s=5, stride_s=0.5, fps=30),
        "scale": Scale(clamp=True),
    },
    # Lodge (Li et al., CVPR 2024): trimmed tracks, cross-genre split, without training windows that stand still.
    "lodge-global": _lodge(1024, 1024 // 10),
    "lodge-local": _lodge(256, 256 // 8),
    # FineDance (Li et al. 2023): whole tracks, 130 ignored as well, the root relative to each window's first frame.
    "finenet": {
        "fields": (Relative("finedance319"), "librosa35"),
        "windows": Windows(length=120, stride=12, fps=30),
        "select": Select(
            ignore=("ignored", "ignored.finenet"),
            protocol="cross_genre",
            filter={"movement": {"field": "finedance319"}},
        ),
        "scale": None,
    },
}

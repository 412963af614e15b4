"""Keys of a recipe that are changed by a call or on the command line."""

from collections.abc import Mapping
from copy import deepcopy
from itertools import pairwise
from typing import Any

import yaml

from dancedata.core.arguments import Overrides
from dancedata.core.errors import UsageError
from dancedata.core.registry import Registry
from dancedata.files.yaml import load_yaml
from dancedata.recipes.plugins import SLOTS, named_entries

_TWINS = {"length_s": "length_frames", "length_frames": "length_s"}
_TWINS |= {key.replace("length", "stride"): twin.replace("length", "stride") for key, twin in _TWINS.items()}


def override_keys(document: dict[str, Any], overrides: Overrides) -> None:
    """Set keys of a recipe document in place, see `load_recipe`."""
    if isinstance(overrides, Mapping):
        for key, value in overrides.items():
            _set_key(document, key, deepcopy(value))
    else:
        for override in [overrides] if isinstance(overrides, str) else overrides:
            apply_override(document, override)


def apply_override(document: dict[str, Any], override: str) -> None:
    """Set one key of a recipe document in place: ``windows.stride_s=1``."""
    key, equals, text = override.partition("=")
    if not equals:
        raise UsageError("an override is key=value", found=repr(override), allowed="such as windows.stride_s=1")
    try:
        value = load_yaml(text)
    except yaml.YAMLError as error:
        raise UsageError("the value of an override cannot be read", where=key, found=repr(text)) from error
    _set_key(document, key, value)


def _set_key(document: dict[str, Any], key: str, value: Any) -> None:
    """Set one key of a recipe document in place: ``"windows.stride_s"`` to 1."""
    parts = key.strip().split(".")
    if not all(parts):
        raise UsageError("not a key of a recipe", found=repr(key), allowed="such as windows.stride_s")
    *above, last = _steps(document, parts)
    level: Any = document
    for step, below in pairwise((*above, last)):
        if level is document and step == "transforms":
            level = _entry(document, below)
            continue
        if not isinstance(level.get(step), dict):
            # "dataset: aist++" and "librosa35:" are short for a mapping.
            level[step] = {level[step]: {}} if isinstance(level.get(step), str) else {}
        level = level[step]
    if above == ["windows"]:
        level.pop(_TWINS.get(last), None)
    level[last] = value


def _entry(document: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the entry of a transform, ``{name: parameters}``; a recipe without it has it as its last one then."""
    chain = document.get("transforms")
    chain = chain if isinstance(chain, list) else [chain] if isinstance(chain, str) else []
    document["transforms"] = chain = [{entry: {}} if isinstance(entry, str) else entry for entry in chain]
    entry = next((entry for entry in chain if isinstance(entry, dict) and name in entry), None)
    if entry is None:
        entry = {name: {}}
        chain.append(entry)
    return entry


def _steps(document: Mapping[str, Any], parts: list[str]) -> list[str]:
    """Return the keys that an override names, from the top: at each level the longest that exists or may be added."""
    level: Any = document
    registry: Registry[Any] | None = None
    steps: list[str] = []
    while parts:
        level = level if isinstance(level, dict) else {}
        for n in range(len(parts), 0, -1):
            step = ".".join(parts[:n])
            if n == 1 or step in level or (registry is not None and step in registry):
                break
        parts = parts[n:]
        registry = None if steps else SLOTS.get(step)
        level = level.get(step)
        level = named_entries(level) if registry is not None else level
        steps.append(step)
    return steps

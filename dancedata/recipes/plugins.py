"""Plug-ins made from their names and parameters, as recipes and protocols have them."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from dancedata.core.errors import DanceDataError, RecipeError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.plugin_files import without_file_key
from dancedata.core.plugins import Plugin
from dancedata.core.registry import (
    ANNOTATORS,
    AUGMENTATIONS,
    DATASETS,
    FEATURES,
    FIELDS,
    KEYMOTIONS,
    REPRESENTATIONS,
    RULES,
    TRANSFORMS,
    Registry,
)
from dancedata.core.text import shown

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

P = TypeVar("P", bound=Plugin)
R = TypeVar("R")
T = TypeVar("T", bound="DataclassInstance")

#: Registry of each slot, by its key in a recipe; rules may be window filters, too.
SLOTS: dict[str, Registry[Any]] = {
    "dataset": DATASETS,
    "transforms": TRANSFORMS,
    "motion": REPRESENTATIONS,
    "audio": FEATURES,
    "keymotion": KEYMOTIONS,
    "fields": FIELDS,
    "augment": AUGMENTATIONS,
    "annotators": ANNOTATORS,
    "rules": RULES,
}
#: Annotators that every build has, with their defaults.
ALWAYS = ("captions", "vitals")
#: Slots whose plug-ins an unknown key may be.
_ADDED = ("transforms", "fields", "augment", "annotators", "rules")
#: Keys of a slot in addition to the plug-in's.
SLOT_KEYS = {"motion": ("contacts", "optional"), "audio": ("fps",), "keymotion": ("optional",)}
#: Motion is resampled to a recipe's rate however slowly it was captured: a billion per second would fill any memory.
_MAX_FPS = 1000
_LABEL = re.compile(r"[A-Za-z0-9_-]+")


class Problems(list[str]):
    """The problems of one document, which are reported together."""

    def catch(self, make: Callable[[], R], where: str = "") -> R | None:
        """Return the result of a call; None, and one problem more, if it raises."""
        try:
            return make()
        except DanceDataError as error:
            self.append(f"{where}{error}")
            return None


def frame_grid(fps: Any, key: str = "fps") -> FrameGrid:
    """Return the grid of a rate in a recipe; UsageError if it is not a number above 0, or above 1,000."""
    try:
        # A boolean is a number to Python.
        grid = FrameGrid.of(repr(fps) if fps is None or isinstance(fps, bool) else fps)
    except UsageError as error:
        raise UsageError(f"{key}: {error}") from error
    if grid.rate > _MAX_FPS:
        raise UsageError(
            f"{key} is too high", found=shown(str(grid), 40), allowed=f"at most {_MAX_FPS:,} frames per second"
        )
    return grid


def make_plugin(
    registry: Registry[P],
    where: str,
    name: str,
    parameters: Any,
    problems: list[str],
    *,
    beside: Any = None,
    several: bool = False,
) -> P | None:
    """Make a plug-in of the slot `where`, which holds `beside`; None, and problems added, if there are some."""
    keys = SLOT_KEYS.get(where, ()) if several else ()
    plugin, label = registry.split(name) if several else (name, None)
    if label is not None and not _LABEL.fullmatch(label):
        problems.append(
            f"{where}.{shown(name)}: not a valid name for an instance of {plugin}; allowed: letters, digits, - and _ "
            f"after the point, such as {plugin}.second"
        )
        return None
    try:
        cls = registry.get(plugin, _key_paths(registry, where, beside), parameters)
        if isinstance(parameters, dict):
            parameters = without_file_key(cls, parameters, name)
    except DanceDataError as error:
        problems.append(f"{where}: {error}")
        return None
    return make_dataclass(cls, f"{where}.{name}", parameters, problems, keys)


def single_plugin(registry: Registry[P], where: str, plugin: Any, problems: list[str]) -> P | None:
    """Make the one plug-in of a slot, written as ``name`` or ``{name: {parameters}}``."""
    if isinstance(plugin, str):
        plugin = {plugin: {}}
    strange = [name for name in plugin if name not in registry] if isinstance(plugin, dict) else []
    if strange and len(plugin) - len(strange) == 1:
        # "dataset.split=all" where "dataset.aist++.split=all" was meant.
        meant = tuple(_key_paths(registry, where, plugin))
        problems += [
            f"{where}.{shown(name)}: unknown key; {did_you_mean(str(name), registry.names(), meant)}"
            for name in strange
        ]
        return None
    if not isinstance(plugin, dict) or len(plugin) != 1:
        names = ", ".join(registry.names())
        problems.append(
            f"{where}: name one {registry.kind}, as in {{name: {{}}}}; known: {names}; found {shown(repr(plugin))}"
        )
        return None
    ((name, parameters),) = plugin.items()
    return make_plugin(registry, where, str(name), parameters, problems)


def make_named(registry: Registry[P], where: str, name: str, parameters: dict[str, Any]) -> P:
    """Make one plug-in for a call from Python: UsageError for an unknown name, RecipeError for wrong parameters."""
    registry.get(name)  # an unknown name is a separate error, with the closest known one
    problems: list[str] = []
    plugin = make_plugin(registry, where, name, parameters, problems)
    if plugin is None:
        raise RecipeError("; ".join(problems))
    return plugin


def make_dataclass(
    cls: type[T], where: str, parameters: Any, problems: list[str], also: tuple[str, ...] = ()
) -> T | None:
    """Make an object of a frozen dataclass from the parameters of a recipe."""
    parameters = {} if parameters is None else parameters
    if not isinstance(parameters, dict):
        problems.append(f"{where}: parameters are a mapping of keys; found {shown(repr(parameters))}")
        return None
    fields = {f.name: f.default for f in dataclasses.fields(cls)}
    unknown = [str(key) for key in parameters if key not in fields]
    problems += [f"{where}.{shown(key)}: unknown key; {did_you_mean(key, (*fields, *also))}" for key in unknown]
    # Defaults are validated as well: a default of 100 and a value of 100.0 have to be the same recipe.
    values = {k: v for k, v in {**fields, **parameters}.items() if k in fields and v is not dataclasses.MISSING}
    try:
        plugin = TypeAdapter(cls).validate_python(values)
    except ValidationError as error:
        problems += [
            f"{where}.{'.'.join(str(p) for p in e['loc'])}: {e['msg']}; found {shown(repr(e['input']))}"
            for e in error.errors()
        ]
        return None
    except DanceDataError as error:
        text = str(error)
        of_key = re.split("[.:]", text, maxsplit=1)[0] in fields  # "spikes: must be ..."
        problems.append(f"{where}.{text}" if of_key else f"{where}: {text}")
        return None
    return None if unknown else _with_whole_paths(plugin)


def _with_whole_paths(plugin: T) -> T:
    """Return a plug-in whose paths begin at the root: workers of a cluster run in other folders."""
    paths = {f.name: getattr(plugin, f.name) for f in dataclasses.fields(plugin) if f.metadata.get("path")}
    # os.path leaves the home of an unknown user as it is; what reads the path then names it.
    whole = {k: Path(os.path.expanduser(p)).absolute() for k, p in paths.items() if isinstance(p, Path)}
    return dataclasses.replace(plugin, **whole) if whole else plugin


def named_entries(slot: Any) -> dict[Any, Any]:
    """Return the entries of a slot by name: of a mapping, a single name, or a list of both."""
    if isinstance(slot, dict):
        return slot
    entries = slot if isinstance(slot, list) else [] if slot is None else [slot]
    return {k: v for entry in entries for k, v in (entry if isinstance(entry, dict) else {str(entry): {}}).items()}


def slot_keys(document: Mapping[str, Any]) -> Iterator[str]:
    """Yield the keys of all plug-ins that a document names, as --set takes them, and of those that it may add."""
    for slot, registry in SLOTS.items():
        more = dict.fromkeys(registry.names()) if slot in _ADDED else {}
        yield from _key_paths(registry, slot, {**more, **named_entries(document.get(slot))})


def _key_paths(registry: Registry[P], where: str, plugins: Any) -> Iterator[str]:
    """Yield the keys of the plug-ins that a slot names, as --set takes them: "audio.librosa35.tightness"."""
    for name in named_entries(plugins):
        plugin, _ = registry.split(str(name))
        if plugin in registry:
            keys = [f.name for f in dataclasses.fields(registry.get(plugin))]
            yield f"{where}.{name}"
            yield from (f"{where}.{name}.{key}" for key in (*keys, *SLOT_KEYS.get(where, ())))

"""Recipes: YAML that names one plug-in for each slot, with its parameters."""

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from dancedata.core.arguments import Overrides
from dancedata.core.errors import RecipeError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid, WindowSpec, as_fraction
from dancedata.core.plugin_files import load_plugins
from dancedata.core.registry import DATASETS
from dancedata.core.resources import resource, resources
from dancedata.core.text import shown
from dancedata.files.yaml import read_yaml
from dancedata.recipes.plugins import SLOTS, Problems, frame_grid, slot_keys
from dancedata.recipes.recipe import Recipe
from dancedata.recipes.slots import make_slots
from dancedata.store.schema import DATASET_FILE

if TYPE_CHECKING:
    from dancedata.store.dataset import Store

#: Characters shown of a PyYAML error, which has several lines.
_YAML_PROBLEM = 600
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")


def recipe_names() -> tuple[str, ...]:
    """Return the names of the recipes that come with the package."""
    return tuple(name.removesuffix(".yaml") for name in resources("pipelines"))


def load_recipe(recipe: str | Path | Mapping[str, Any] | Recipe, overrides: Overrides = ()) -> Recipe:
    """Read a recipe, by its name or file or as a document, and change some of its keys; a checked one stays as it is.

    `overrides`: ``"windows.stride_s=1"`` as on the command line, or ``{"windows.stride_s": 1}``.
    Raises RecipeError, which lists every problem; UsageError for a file that does not exist or cannot be loaded.
    """
    if isinstance(recipe, Recipe):
        if overrides:
            raise UsageError("a parsed recipe takes no overrides", found=recipe,
                             fix="give its name, its file or its document instead")  # fmt: skip
        return recipe
    folder = Path()
    if isinstance(recipe, Mapping):
        document = deepcopy(dict(recipe))
    else:
        file = _recipe_file(str(recipe))
        document, folder = _read(file), file.parent
    where = "recipe" if isinstance(recipe, Mapping) else str(recipe)
    if overrides:
        from dancedata.recipes.overrides import override_keys

        override_keys(document, overrides)
    _load_plugins(document.pop("plugins", []), folder, where)
    return parse_recipe(document, where=where)


def _load_plugins(files: Any, folder: Path, where: str) -> None:
    """Load the local plug-ins that a recipe names. `parse_recipe` does not: it also reads recipes of datasets."""
    if not isinstance(files, list) or not all(isinstance(file, str) and file for file in files):
        raise RecipeError(
            "plugins: not a list of files", where=where, found=shown(repr(files)), allowed="such as [./loudness.py]"
        )
    load_plugins(*(folder / Path(file).expanduser() for file in files))


def _recipe_file(name: str) -> Path:
    path = Path(name).expanduser()
    if path.suffix in (".yaml", ".yml") or path.is_file():
        if not path.exists():
            raise UsageError("the recipe file does not exist", where=path)
        return path
    if name in recipe_names():
        return resource("pipelines", f"{name}.yaml")
    problem = f"unknown recipe {name!r}"
    fix = f"{did_you_mean(name, recipe_names())}; or give the path of a .yaml file"
    if path.is_dir():
        problem, fix = f"{problem}: it is a folder", f"name a recipe, and the folder after it; {fix}"
    elif name in DATASETS:
        problem, fix = f"{problem}: it is a dataset", f"write a recipe with dataset: {name}; {fix}"
    raise UsageError(problem, fix=fix)


def _read(path: Path) -> dict[str, Any]:
    try:
        document = read_yaml(path)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RecipeError("the recipe cannot be read", where=path, found=str(error)[:_YAML_PROBLEM]) from error
    if not isinstance(document, dict):
        content = "an empty file" if document is None else type(document).__name__
        raise RecipeError("a recipe is a mapping of keys", where=path, found=content)
    return document


def stored_recipe(store: "Store") -> Recipe:
    """Return the recipe of a dataset; RecipeError where its plug-ins are not installed."""
    return parse_recipe(store.info.get("recipe", {}), where=f"{store.path}/{DATASET_FILE}")


def parse_recipe(document: Mapping[str, Any], where: str = "recipe") -> Recipe:
    """Check a recipe document and make its plug-ins; RecipeError lists every problem at once."""
    problems = Problems()
    sections = {name: _checked(document, name, problems) for name in _KEYS}
    top, lengths, store, groups = (sections[name] for name in ("", "windows", "store", "groups"))
    grid = problems.catch(partial(frame_grid, document.get("fps", 30)))
    windows = None
    if lengths is not None and grid is not None:
        windows = problems.catch(partial(_windows, lengths, grid))
    slots = make_slots(document, grid, windows, problems)
    if problems or not (top and store and groups) or grid is None or windows is None:
        listed = "\n".join(f"  - {p}" for p in problems)
        raise RecipeError(f"{len(problems)} problem{'s' * (len(problems) != 1)} in the recipe\n{listed}", where=where)
    return Recipe(
        name=top["name"],
        description=top["description"],
        grid=grid,
        windows=windows,
        **vars(slots),
        shard_mb=store["shard_mb"],
        incomplete_groups=groups["incomplete"],
    )


def _windows(keys: Mapping[str, Any], grid: FrameGrid) -> WindowSpec:
    frames = {}
    for what in ("length", "stride"):
        seconds, count = keys[f"{what}_s"], keys[f"{what}_frames"]
        if (seconds is None) == (count is None):
            both = "neither" if count is None else "both"
            raise UsageError(f"windows: give one of {what}_s and {what}_frames", found=both)
        frames[what] = count or grid.frames(seconds, f"windows.{what}_s")
        if frames[what] < 1:
            raise UsageError(f"windows: the {what} must be above 0", found=seconds)
    return WindowSpec(frames["length"], frames["stride"], grid)


@dataclass(frozen=True)
class _Key:
    """One key of a recipe; `convert` returns None for a wrong value, `problem` is the message."""

    default: Any = None
    problem: str = ""
    convert: Callable[[Any], Any] = lambda value: value
    allowed: str = ""


def _checked(document: Mapping[str, Any], section: str, problems: Problems) -> dict[str, Any] | None:
    """Return the values of a section, defaults included; None, and the problems added, if anything is wrong."""
    keys, above = _KEYS[section], f"{section}." if section else ""
    content = document if not section else document.get(section, _KEYS[""][section].default)
    if not isinstance(content, Mapping):
        if content is not _MISSING:
            problems.append(f"{section}: not a mapping of keys; found {shown(repr(content))}")
        return None
    n_before, values = len(problems), {}
    for name, key in keys.items():
        value = values[name] = content.get(name, key.default)
        if value is _MISSING:
            problems.append(f"{above}{name}: missing")
        elif value is not key.default:
            values[name] = key.convert(value)
            if values[name] is None and key.problem:
                allowed = f"; allowed: {key.allowed}" if key.allowed else ""
                problems.append(f"{above}{name}: {key.problem}; found {shown(repr(value))}{allowed}")
    for name in (name for name in content if name not in keys):
        below = [f"{above}.{key}" for above, keys in _KEYS.items() if above for key in keys]
        meant = did_you_mean(str(name), keys, [*below, *slot_keys(document)])
        problems.append(f"{above}{shown(name)}: unknown key; {meant}")
    return values if len(problems) == n_before else None


def _name(value: Any) -> str | None:
    return value if isinstance(value, str) and _NAME.fullmatch(value) else None


def _count(value: Any) -> int | None:
    with suppress(UsageError):
        number = as_fraction(value, "count")
        if number.denominator == 1 and number >= 1 and not isinstance(value, bool):
            return int(number)
    return None


def _seconds(value: Any) -> int | float | str | None:
    return value if isinstance(value, int | float | str) and not isinstance(value, bool) else None


def _choice(*values: str) -> _Key:
    problem = f"must be {' or '.join(map(repr, values))}"
    return _Key(values[0], problem, lambda value: value if value in values else None)


_MISSING: Any = object()
_SECONDS = _Key(None, "not a number or a fraction such as 30000/1001", _seconds)
_COUNT = _Key(None, "must be a whole number of at least 1", _count)
#: The keys of each section; slots and the rate are checked where they are made.
_KEYS = {
    "": {
        "recipe": _Key(_MISSING, "must be 1", lambda value: value if type(value) is int and value == 1 else None),
        "name": _Key(_MISSING, "not a valid name", _name, "letters, digits and _ . + -, a letter or digit first"),
        "description": _Key("", "must be a text", lambda value: value if isinstance(value, str) else None),
        "fps": _Key(),
        "windows": _Key(_MISSING),
        **dict.fromkeys(SLOTS, _Key()),
        "store": _Key({}),
        "groups": _Key({}),
    },
    "windows": {"length_s": _SECONDS, "length_frames": _COUNT, "stride_s": _SECONDS, "stride_frames": _COUNT},
    "store": {"shard_mb": replace(_COUNT, default=256)},
    "groups": {"incomplete": _choice("set_aside", "keep")},
}

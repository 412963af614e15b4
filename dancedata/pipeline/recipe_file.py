"""Recipes: YAML that names one plug-in for each slot, with its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from dancedata.core.errors import DanceDataError, RecipeError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.movement import Movement
from dancedata.core.registry import CONTACTS, DATASETS, FEATURES, KEYMOTIONS, REPRESENTATIONS, Registry
from dancedata.core.resources import resource, resources
from dancedata.core.text import shown
from dancedata.pipeline.recipe import MotionSlot, Recipe, WindowSpec
from dancedata.pipeline.slots import key_paths, make_dataclass, make_plugin, one_of
from dancedata.pipeline.strict_yaml import load_yaml, read_yaml

#: Characters of what PyYAML says, which are several lines.
_YAML_PROBLEM = 600
#: Motion is brought to a recipe's rate however slowly it was captured: a billion a second would fill any memory.
MAX_FPS = 1000


def _number(value: Any) -> Any:
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float | str)):
        raise ValueError("a number, or a fraction such as 30000/1001, is wanted")
    return value


#: A number as it is written: 29.97 and "30000/1001" are exact, see core.grid.
Scalar = Annotated[Any, BeforeValidator(_number)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Windows(_Strict):
    length_s: Scalar | None = None
    length_frames: int | None = Field(default=None, ge=1)
    stride_s: Scalar | None = None
    stride_frames: int | None = Field(default=None, ge=1)
    order: Literal["time", "name"] = "time"
    filter: Any = None


class _Augment(_Strict):
    mirror: bool = False


class _Store(_Strict):
    shard_mb: int = Field(default=256, ge=1)


class _Document(_Strict):
    recipe: Literal[1]
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")
    description: str = ""
    dataset: Any
    fps: Scalar = 30
    scope: Literal["track", "window"] = "track"
    windows: _Windows
    motion: Any
    audio: Any = None
    keymotion: Any = None
    augment: _Augment = _Augment()
    store: _Store = _Store()


_MODELS: dict[str, type[BaseModel]] = {"windows": _Windows, "store": _Store, "augment": _Augment}
_SLOTS = {"dataset": DATASETS, "motion": REPRESENTATIONS, "audio": FEATURES, "keymotion": KEYMOTIONS}


def recipe_names() -> tuple[str, ...]:
    """Return the names of the recipes that come with the package."""
    return tuple(name.removesuffix(".yaml") for name in resources("pipelines"))


def load_recipe(name_or_path: str | Path, overrides: Sequence[str] = ()) -> Recipe:
    """Read a recipe by name or from a YAML file, and apply ``key.key=value`` overrides.

    Raises
    ------
    RecipeError
        Listing every problem at once.
    UsageError
        If there is no such recipe.
    """
    path = _find(str(name_or_path))
    try:
        document = read_yaml(path)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RecipeError("the recipe cannot be read", where=path, found=str(error)[:_YAML_PROBLEM]) from error
    if not isinstance(document, dict):
        found = "an empty file" if document is None else type(document).__name__
        raise RecipeError("a recipe is a mapping of keys", where=path, found=found)
    for override in overrides:
        apply_override(document, override)
    return parse_recipe(document, where=str(name_or_path))


def apply_override(document: dict[str, Any], override: str) -> None:
    """Set one key of a recipe document in place: ``windows.stride_s=1``."""
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise UsageError("an override is key=value", found=repr(override), allowed="such as windows.stride_s=1")
    try:
        value = load_yaml(text)
    except yaml.YAMLError as error:
        raise UsageError("the value of an override cannot be read", where=key, found=repr(text)) from error
    at: Any = document
    for part in parts[:-1]:
        if not isinstance(at.get(part), dict):
            # "dataset: aist++" and "librosa35:" are short for a mapping.
            at[part] = {at[part]: {}} if isinstance(at.get(part), str) else {}
        at = at[part]
    last = parts[-1]
    twin = {"length_s": "length_frames", "stride_s": "stride_frames"}
    for one, other in [*twin.items(), *((b, a) for a, b in twin.items())]:
        if parts[:-1] == ["windows"] and last == one:
            at.pop(other, None)
    at[last] = value


def parse_recipe(document: Mapping[str, Any], where: str = "recipe") -> Recipe:
    """Check a recipe document and make its plug-ins.

    Raises
    ------
    RecipeError
        Listing every problem at once, unknown keys with the closest known one.
    """
    problems: list[str] = []
    try:
        model = _Document.model_validate(document)
    except ValidationError as error:
        problems += _explain(error, document)
        # Look into the slots as well, so that their errors come in the same message.
        model = None
    given = document if model is None else model.__dict__
    dataset = _attempt(problems, lambda: one_of(DATASETS, "dataset", given.get("dataset"), problems))
    motion = _motion_slots(given.get("motion"), problems)
    audio = _slots(FEATURES, "audio", given.get("audio"), problems)
    keymotion = _slots(KEYMOTIONS, "keymotion", given.get("keymotion"), problems)
    grid = _attempt(problems, lambda: _grid(given.get("fps", 30)))
    spec = model.windows if model is not None else _window_keys(given.get("windows"))
    windows = None
    if spec is not None and grid is not None:
        windows = _attempt(problems, lambda: _windows(spec, grid, _filter(spec.filter, motion, problems)))
    if windows is not None:
        for slot in motion:
            _attempt(problems, partial(_whole_rows, slot, windows, grid))
    if model is not None and model.augment.mirror:
        without = [slot.name for slot in motion if slot.representation.columns.mirror is None]
        problems += [f"augment.mirror: {name} has no mirror image" for name in without]
    if grid is not None:
        for feature in audio:
            # A rate that a feature cannot do is said now, not after all music was decoded.
            _attempt(problems, partial(feature.n_rows, 1, 48_000, grid))
    if problems or model is None or grid is None or windows is None:
        listed = "\n".join(f"  - {p}" for p in problems)
        raise RecipeError(f"{len(problems)} problem{'s' * (len(problems) != 1)} in the recipe\n{listed}", where=where)
    return Recipe(
        name=model.name,
        description=model.description,
        dataset=dataset,
        grid=grid,
        scope=model.scope,
        windows=windows,
        motion=motion,
        audio=audio,
        keymotion=keymotion,
        mirror=model.augment.mirror,
        shard_mb=model.store.shard_mb,
    )


def _find(name: str) -> Path:
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        if not path.exists():
            raise UsageError("there is no such recipe file", where=path)
        return path
    if name in recipe_names():
        return resource("pipelines", f"{name}.yaml")
    problem = f"unknown recipe {name!r}"
    fix = f"{did_you_mean(name, recipe_names())}; or give the path of a .yaml file"
    if path.is_dir():
        problem, fix = f"{problem}: it is a folder", f"name a recipe, and the folder with --source; {fix}"
    elif name in DATASETS.names():
        problem, fix = f"{problem}: it is a dataset", f"write a recipe with dataset: {name}; {fix}"
    raise UsageError(problem, fix=fix)


def _attempt(problems: list[str], make: Any) -> Any:
    try:
        return make()
    except DanceDataError as error:
        problems.append(str(error))
        return None


def _motion_slots(given: Any, problems: list[str]) -> tuple[MotionSlot, ...]:
    if not isinstance(given, (dict, str)) or not given:
        several = given if isinstance(given, list) and all(isinstance(name, str) for name in given) else []
        example = ", ".join(f"{shown(name)}: {{}}" for name in several or ["edge151"])
        problems.append(
            f"motion: name at least one representation, such as {{{example}}}; found {shown(repr(given))}"
        )
        return ()
    slots = []
    for name, parameters in _mapping(given).items():
        own = dict(parameters or {}) if isinstance(parameters, dict | None) else parameters
        rule = own.pop("contacts", None) if isinstance(own, dict) else None
        made = make_plugin(REPRESENTATIONS, "motion", name, own, problems, also=("contacts",), beside=given)
        if made is None:
            continue
        rule = rule if rule is not None else made.default_contacts
        if rule is not None and made.default_contacts is None:
            problems.append(f"motion.{name}.contacts: {name} holds no contacts")
        contacts = None if rule is None else one_of(CONTACTS, f"motion.{name}.contacts", rule, problems)
        slots.append(MotionSlot(made, contacts))
    return tuple(sorted(slots, key=lambda slot: slot.name))


def _slots(registry: Registry, where: str, given: Any, problems: list[str]) -> tuple[Any, ...]:
    named = _mapping(given or {})
    made = [make_plugin(registry, where, name, own, problems, beside=named) for name, own in named.items()]
    # By name, as in the recipe's hash, which knows no order either.
    return tuple(sorted((m for m in made if m is not None), key=lambda m: str(m.name)))


def _mapping(given: Any) -> dict[str, Any]:
    return {given: {}} if isinstance(given, str) else dict(given) if isinstance(given, dict) else {str(given): {}}


def _grid(fps: Any) -> FrameGrid:
    try:
        grid = FrameGrid.of(_number(fps if fps is not None else ""))
    except (UsageError, ValueError) as error:
        raise UsageError(f"fps: {error}") from error
    if grid.rate > MAX_FPS:
        raise UsageError(
            "fps is too high", found=shown(str(grid), 40), allowed=f"at most {MAX_FPS:,} frames a second"
        )
    return grid


def _window_keys(given: Any) -> _Windows | None:
    try:
        return _Windows.model_validate(given)
    except ValidationError:
        return None  # said already, with the rest of the document


def _filter(given: Any, motion: Sequence[MotionSlot], problems: list[str]) -> Movement | None:
    if given is None:
        return None
    given = {given: {}} if isinstance(given, str) else given
    if not isinstance(given, dict) or list(given) != ["movement"]:
        problems.append(
            f"windows.filter: name the filter, as in {{movement: {{min_std: 0.07}}}}; found {shown(repr(given))}"
        )
        return None
    made: Movement | None = make_dataclass(Movement, "windows.filter.movement", given["movement"], problems)
    names = [slot.name for slot in motion]
    if made is not None and made.field not in names:
        problems.append(f"windows.filter.movement.field: no such field in motion; {did_you_mean(made.field, names)}")
    return made


def _whole_rows(slot: MotionSlot, windows: WindowSpec, grid: FrameGrid) -> None:
    """Raise UsageError unless windows begin and end at rows of a field that has a rate of its own."""
    rate = slot.representation.rate
    for what, frames in (("length", windows.length), ("stride", windows.stride)):
        rows = frames if rate is None else frames * rate / grid.rate
        if rows != int(rows):
            raise UsageError(
                f"windows: the {what} is no whole number of rows of {slot.name}",
                found=f"{frames} frames at {grid} a second, rows at {rate} a second",
                allowed="lengths and strides that are multiples of both periods",
            )


def _windows(given: _Windows, grid: FrameGrid, chosen: Movement | None) -> WindowSpec:
    found = {}
    for what in ("length", "stride"):
        seconds, frames = getattr(given, f"{what}_s"), getattr(given, f"{what}_frames")
        if (seconds is None) == (frames is None):
            raise UsageError(
                f"windows: give one of {what}_s and {what}_frames", found="both" if frames is not None else "neither"
            )
        found[what] = frames if frames is not None else grid.frames(seconds, f"windows.{what}_s")
        if found[what] < 1:
            raise UsageError(f"windows: the {what} must be above 0", found=seconds)
    return WindowSpec(found["length"], found["stride"], given.order, chosen)


def _key_paths(document: Mapping[str, Any]) -> list[str]:
    """Return all keys below the top, as --set takes them, of the plug-ins that the document names."""
    paths = [f"{name}.{key}" for name, model in _MODELS.items() for key in model.model_fields]
    for slot, registry in _SLOTS.items():
        also = ("contacts",) if slot == "motion" else ()
        paths += key_paths(registry, slot, document.get(slot), also)
    return paths


def _explain(error: ValidationError, document: Mapping[str, Any]) -> list[str]:
    problems = []
    for item in error.errors():
        key = ".".join(shown(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            model: Any = _MODELS.get(str(item["loc"][0]), _Document)
            meant = did_you_mean(str(item["loc"][-1]), model.model_fields, _key_paths(document))
            problems.append(f"{key}: unknown key; {meant}")
        elif item["type"] == "missing":
            if key not in ("dataset", "motion"):  # these say by themselves what may stand there
                problems.append(f"{key}: missing")
        else:
            problems.append(_invalid(key, item))
    return problems


def _invalid(key: str, item: Any) -> str:
    if item["type"] in ("model_type", "dict_type"):
        return f"{key}: a mapping of keys is wanted; found {shown(repr(item['input']))}"
    if item["type"] == "string_pattern_mismatch":
        allowed = "letters, digits and _ . + -, a letter or digit first"
        return f"{key}: not a valid name; found {shown(repr(item['input']))}; allowed: {allowed}"
    return f"{key}: {item['msg'].removeprefix('Value error, ')}; found {shown(repr(item['input']))}"

"""Recipes: YAML that names one plug-in for each slot, with its parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from dancedata.core.columns import Columns
from dancedata.core.errors import DanceDataError, RecipeError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import WindowFilter
from dancedata.core.registry import (
    AUGMENTATIONS,
    CONTACTS,
    DATASETS,
    FEATURES,
    FILTERS,
    KEYMOTIONS,
    REPRESENTATIONS,
    Registry,
)
from dancedata.core.resources import resource, resources
from dancedata.core.text import shown
from dancedata.recipes.fields import FeatureJob, FieldSpec, KeyMotionField, MotionField, WindowSpec
from dancedata.recipes.plugins import copy_specs, key_paths, longest_key, make_instance, one_of
from dancedata.recipes.recipe import Recipe
from dancedata.recipes.yaml import load_yaml, read_yaml

F = TypeVar("F", bound=FieldSpec)
T = TypeVar("T")

#: Characters shown of a PyYAML error, which has several lines.
_YAML_PROBLEM = 600
#: Motion is brought to a recipe's rate however slowly it was captured: a billion a second would fill any memory.
MAX_FPS = 1000


def _number(value: Any) -> Any:
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float | str)):
        raise ValueError("not a number or a fraction such as 30000/1001")
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
    augment: Any = None
    store: _Store = _Store()


_MODELS: dict[str, type[BaseModel]] = {"windows": _Windows, "store": _Store}
_SLOTS: dict[str, Registry[Any]] = {
    "dataset": DATASETS,
    "motion": REPRESENTATIONS,
    "audio": FEATURES,
    "keymotion": KEYMOTIONS,
    "augment": AUGMENTATIONS,
}

#: Keys of a slot beside the plug-in's own.
_SLOT_KEYS = {"motion": ("contacts",), "audio": ("fps",)}


def recipe_names() -> tuple[str, ...]:
    """Return the names of the recipes that come with the package."""
    return tuple(name.removesuffix(".yaml") for name in resources("pipelines"))


def load_recipe(
    recipe: str | Path | Mapping[str, Any] | Recipe, overrides: Iterable[str] | Mapping[str, Any] = ()
) -> Recipe:
    """Read a recipe and change some of its keys.

    Parameters
    ----------
    recipe
        Name of a recipe that comes with the package, path of a YAML file, or the document itself. A recipe that is
        checked already is returned as it is.
    overrides
        Keys to change: ``"windows.stride_s=1"`` as on the command line, or ``{"windows.stride_s": 1}``.

    Raises
    ------
    RecipeError
        Listing every problem at once.
    UsageError
        If the recipe does not exist.
    """
    if isinstance(recipe, Recipe):
        if overrides:
            raise UsageError(
                "a recipe that is checked already takes no overrides",
                found=recipe,
                fix="give its name, its file or its document instead",
            )
        return recipe
    document = deepcopy(dict(recipe)) if isinstance(recipe, Mapping) else _read(_find(str(recipe)))
    if isinstance(overrides, str):
        overrides = [overrides]
    if isinstance(overrides, Mapping):
        for key, value in overrides.items():
            set_key(document, key, deepcopy(value))
    else:
        for override in overrides:
            apply_override(document, override)
    return parse_recipe(document, where="recipe" if isinstance(recipe, Mapping) else str(recipe))


def _read(path: Path) -> dict[str, Any]:
    try:
        document = read_yaml(path)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RecipeError("the recipe cannot be read", where=path, found=str(error)[:_YAML_PROBLEM]) from error
    if not isinstance(document, dict):
        found = "an empty file" if document is None else type(document).__name__
        raise RecipeError("a recipe is a mapping of keys", where=path, found=found)
    return document


def apply_override(document: dict[str, Any], override: str) -> None:
    """Set one key of a recipe document in place: ``windows.stride_s=1``."""
    key, equals, text = override.partition("=")
    if not equals:
        raise UsageError("an override is key=value", found=repr(override), allowed="such as windows.stride_s=1")
    try:
        value = load_yaml(text)
    except yaml.YAMLError as error:
        raise UsageError("the value of an override cannot be read", where=key, found=repr(text)) from error
    set_key(document, key, value)


def set_key(document: dict[str, Any], key: str, value: Any) -> None:
    """Set one key of a recipe document in place: ``"windows.stride_s"`` to 1."""
    parts = key.strip().split(".")
    if not all(parts):
        raise UsageError("not a key of a recipe", found=repr(key), allowed="such as windows.stride_s")
    *above, last = _steps(document, parts)
    at: Any = document
    for step in above:
        if not isinstance(at.get(step), dict):
            # "dataset: aist++" and "librosa35:" are short for a mapping.
            at[step] = {at[step]: {}} if isinstance(at.get(step), str) else {}
        at = at[step]
    twin = {"length_s": "length_frames", "stride_s": "stride_frames"}
    for one, other in [*twin.items(), *((b, a) for a, b in twin.items())]:
        if above == ["windows"] and last == one:
            at.pop(other, None)
    at[last] = value


def _steps(document: Mapping[str, Any], parts: list[str]) -> list[str]:
    """Return the keys that an override names, from the top; at each level the longest that there is or may be."""
    at: Any = document
    registry: Registry[Any] | None = None
    steps: list[str] = []
    while parts:
        step, parts = longest_key(at if isinstance(at, dict) else {}, parts, registry)
        registry = None if steps else _SLOTS.get(step)
        at = at.get(step) if isinstance(at, dict) else None
        steps.append(step)
    return steps


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
    grid = _attempt(problems, lambda: _grid(given.get("fps", 30)))
    # Where the rate is wrong, the fields are looked at all the same, so that their errors come in the same message.
    any_grid = grid or FrameGrid.of(30)
    motion = _motion_fields(given.get("motion"), any_grid, problems)
    keymotion = _key_motion_fields(given.get("keymotion"), any_grid, problems)
    columns = {field.name: field.columns for field in (*motion, *keymotion)}
    augment = copy_specs(given.get("augment"), columns, problems)
    spec = model.windows if model is not None else _window_keys(given.get("windows"))
    windows = None
    if spec is not None and grid is not None:
        chosen = _filter(spec.filter, columns, problems)
        windows = _attempt(problems, lambda: _windows(spec, grid, chosen))
    by_window = windows if model is not None and model.scope == "window" else None
    audio = _feature_jobs(given.get("audio"), any_grid, by_window, problems)
    if windows is not None:
        for field in (*motion, *audio):
            _attempt(problems, partial(field.require_whole, windows))
    for job in audio if grid is not None else ():
        # A rate that a feature cannot compute at is an error now, not after all music was decoded.
        _attempt(problems, partial(job.feature.n_rows, 1, 48_000, job.grid), f"audio.{job.name}: ")
    if problems or model is None or dataset is None or grid is None or windows is None:
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
        augment=augment,
        shard_mb=model.store.shard_mb,
    )


def _find(name: str) -> Path:
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
        problem, fix = f"{problem}: it is a folder", f"name a recipe, and the folder with --source; {fix}"
    elif name in DATASETS:
        problem, fix = f"{problem}: it is a dataset", f"write a recipe with dataset: {name}; {fix}"
    raise UsageError(problem, fix=fix)


def _attempt(problems: list[str], make: Callable[[], T], where: str = "") -> T | None:
    try:
        return make()
    except DanceDataError as error:
        problems.append(f"{where}{error}")
        return None


def _motion_fields(given: Any, grid: FrameGrid, problems: list[str]) -> tuple[MotionField, ...]:
    if not isinstance(given, (dict, str)) or not given:
        several = given if isinstance(given, list) and all(isinstance(name, str) for name in given) else []
        example = ", ".join(f"{shown(name)}: {{}}" for name in several or ["edge151"])
        problems.append(
            f"motion: name at least one representation, such as {{{example}}}; found {shown(repr(given))}"
        )
        return ()
    fields = []
    for name, parameters in _mapping(given).items():
        own, rule = _taken_out("contacts", parameters)
        made = make_instance(REPRESENTATIONS, "motion", name, own, problems, also=("contacts",), beside=given)
        if made is None:
            continue
        rule = rule if rule is not None else made.default_contacts
        if rule is not None and made.default_contacts is None:
            problems.append(f"motion.{name}.contacts: {name} has no contact columns")
        contacts = None if rule is None else one_of(CONTACTS, f"motion.{name}.contacts", rule, problems)
        fields.append(MotionField(name, grid if made.rate is None else FrameGrid(made.rate), made, contacts))
    return _by_name(fields)


def _feature_jobs(
    given: Any, grid: FrameGrid, windows: WindowSpec | None, problems: list[str]
) -> tuple[FeatureJob, ...]:
    jobs = []
    named = _mapping(given or {})
    for name, parameters in named.items():
        own, fps = _taken_out("fps", parameters)
        made = make_instance(FEATURES, "audio", name, own, problems, also=("fps",), beside=named)
        own_grid = grid if fps is None else _attempt(problems, partial(_grid, fps, f"audio.{name}.fps"))
        if made is not None and own_grid is not None:
            jobs.append(FeatureJob(name, own_grid, made, windows, own_grid != grid))
    return _by_name(jobs)


def _key_motion_fields(given: Any, grid: FrameGrid, problems: list[str]) -> tuple[KeyMotionField, ...]:
    named = _mapping(given or {})
    made = {
        name: make_instance(KEYMOTIONS, "keymotion", name, own, problems, beside=named) for name, own in named.items()
    }
    return _by_name([KeyMotionField(name, grid, finder) for name, finder in made.items() if finder is not None])


def _taken_out(key: str, parameters: Any) -> tuple[Any, Any]:
    """Return a plug-in's parameters without a key that belongs to the slot, and its value."""
    if not isinstance(parameters, dict):
        return parameters, None
    return {k: v for k, v in parameters.items() if k != key}, parameters.get(key)


def _by_name(fields: Sequence[F]) -> tuple[F, ...]:
    # As in the recipe's hash, which does not depend on the order.
    return tuple(sorted(fields, key=lambda field: field.name))


def _mapping(given: Any) -> dict[str, Any]:
    if not isinstance(given, dict):
        return {str(given): {}}
    return {str(name): parameters for name, parameters in given.items()}  # in YAML a key may be a number


def _grid(fps: Any, key: str = "fps") -> FrameGrid:
    try:
        grid = FrameGrid.of(_number(fps if fps is not None else ""))
    except (UsageError, ValueError) as error:
        raise UsageError(f"{key}: {error}") from error
    if grid.rate > MAX_FPS:
        raise UsageError(
            f"{key} is too high", found=shown(str(grid), 40), allowed=f"at most {MAX_FPS:,} frames per second"
        )
    return grid


def _window_keys(given: Any) -> _Windows | None:
    try:
        return _Windows.model_validate(given)
    except ValidationError:
        return None  # reported already, with the rest of the document


def _filter(given: Any, fields: Mapping[str, Columns], problems: list[str]) -> WindowFilter | None:
    if given is None:
        return None
    made = one_of(FILTERS, "windows.filter", given, problems)
    if made is None:
        return None
    where = f"windows.filter.{made.name}"
    if made.field not in fields:
        meant = did_you_mean(made.field, fields)
        default = " (the default)" if made.field == getattr(type(made), "field", None) else ""
        problems.append(f"{where}.field: no such field in motion or keymotion: {shown(made.field)}{default}; {meant}")
        return None
    try:
        made.check(fields[made.field])
    except UsageError as error:
        problems.append(f"{where}: field {made.field}: {error}")
    return made


def _windows(given: _Windows, grid: FrameGrid, chosen: WindowFilter | None) -> WindowSpec:
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
    return WindowSpec(found["length"], found["stride"], grid, given.order, chosen)


def _key_paths(document: Mapping[str, Any]) -> list[str]:
    """Return all keys below the top, as --set takes them, of the plug-ins that the document names."""
    paths = [f"{name}.{key}" for name, model in _MODELS.items() for key in model.model_fields]
    paths += key_paths(AUGMENTATIONS, "augment", dict.fromkeys(AUGMENTATIONS.names()))
    for slot, registry in _SLOTS.items():
        paths += key_paths(registry, slot, document.get(slot), _SLOT_KEYS.get(slot, ()))
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
            if key not in ("dataset", "motion"):  # these have errors of their own, with what is allowed
                problems.append(f"{key}: missing")
        else:
            problems.append(_invalid(key, item))
    return problems


def _invalid(key: str, item: Any) -> str:
    if item["type"] in ("model_type", "dict_type"):
        return f"{key}: not a mapping of keys; found {shown(repr(item['input']))}"
    if item["type"] == "string_pattern_mismatch":
        allowed = "letters, digits and _ . + -, a letter or digit first"
        return f"{key}: not a valid name; found {shown(repr(item['input']))}; allowed: {allowed}"
    return f"{key}: {item['msg'].removeprefix('Value error, ')}; found {shown(repr(item['input']))}"

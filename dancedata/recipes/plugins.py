"""Makes plug-ins from the names and parameters of a recipe."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from dancedata.core.columns import Columns
from dancedata.core.errors import DanceDataError, RecipeError, UsageError, did_you_mean
from dancedata.core.plugins import CopyAugmentation, Plugin
from dancedata.core.registry import AUGMENTATIONS, Registry
from dancedata.core.text import shown
from dancedata.recipes.copies import CopySpec

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

P = TypeVar("P", bound=Plugin)
T = TypeVar("T", bound="DataclassInstance")

_LABEL = re.compile(r"[A-Za-z0-9_-]+")


def make_plugin(
    registry: Registry[P],
    where: str,
    name: str,
    parameters: Any,
    problems: list[str],
    also: tuple[str, ...] = (),
    beside: Any = None,
) -> P | None:
    """Make one plug-in. If there are problems, all of them are added to the list, and None is returned.

    `also` names keys of the slot that the caller has taken out of `parameters` already; `beside` is all that the
    slot was given: where `name` is not a plug-in, it may be a key of one that stands beside it.
    """
    try:
        cls = registry.get(name, key_paths(registry, where, beside, also))
    except DanceDataError as error:
        problems.append(f"{where}: {error}")
        return None
    return make_dataclass(cls, f"{where}.{name}", parameters, problems, also)


def make_instance(
    registry: Registry[P],
    where: str,
    name: str,
    parameters: Any,
    problems: list[str],
    also: tuple[str, ...] = (),
    beside: Any = None,
) -> P | None:
    """Make one of several plug-ins of a slot, named PLUGIN or PLUGIN.NAME; as `make_plugin`."""
    plugin, label = registry.split(name)
    if label is None:
        return make_plugin(registry, where, name, parameters, problems, also, beside)
    if not _LABEL.fullmatch(label):
        problems.append(
            f"{where}.{shown(name)}: not a valid name for an instance of {plugin}; allowed: letters, digits, - and _ "
            f"after the point, such as {plugin}.second"
        )
        return None
    return make_dataclass(registry.get(plugin), f"{where}.{name}", parameters, problems, also)


def longest_key(at: Any, parts: list[str], registry: Registry[Any] | None) -> tuple[str, list[str]]:
    """Split off the longest key that a mapping has or that is registered, or else the first part."""
    for n in range(len(parts), 1, -1):
        key = ".".join(parts[:n])
        if key in at or (registry is not None and key in registry):
            return key, parts[n:]
    return parts[0], parts[1:]


def key_paths(registry: Registry[P], where: str, given: Any, also: Sequence[str] = ()) -> Iterator[str]:
    """Yield the keys of the plug-ins that a slot names, as --set takes them: "audio.librosa35.tightness"."""
    names = [given] if isinstance(given, str) else list(given) if isinstance(given, dict) else []
    for name in names:
        plugin, _ = registry.split(str(name))
        if plugin not in registry:
            continue
        keys = [f.name for f in dataclasses.fields(registry.get(plugin))]
        yield f"{where}.{name}"
        yield from (f"{where}.{name}.{key}" for key in (*keys, *also))


def make_named(registry: Registry[P], where: str, name: str, parameters: dict[str, Any]) -> P:
    """Make one plug-in for a call from Python, where a problem is raised at once.

    Raises
    ------
    UsageError
        For an unknown name.
    RecipeError
        For parameters that it does not take, all of them.
    """
    registry.get(name)  # an unknown name is an error of its own, with the closest known one
    problems: list[str] = []
    made = make_plugin(registry, where, name, parameters, problems)
    if made is None:
        raise RecipeError("; ".join(problems))
    return made


def raise_problems(problems: list[str]) -> None:
    """Raise RecipeError if there are any."""
    if problems:
        raise RecipeError("; ".join(problems))


def make_dataclass(
    cls: type[T], at: str, parameters: Any, problems: list[str], also: tuple[str, ...] = ()
) -> T | None:
    """Make an object of a frozen dataclass from the parameters of a recipe."""
    parameters = {} if parameters is None else parameters
    if not isinstance(parameters, dict):
        problems.append(f"{at}: parameters are a mapping of keys; found {shown(repr(parameters))}")
        return None
    known = [f.name for f in dataclasses.fields(cls)]
    unknown = [str(key) for key in parameters if key not in known]
    problems += [f"{at}.{shown(key)}: unknown key; {did_you_mean(key, (*known, *also))}" for key in unknown]
    try:
        # Defaults are validated as well: a default of 100 and a given 100.0 have to be the same recipe.
        defaults = {f.name: f.default for f in dataclasses.fields(cls) if f.default is not dataclasses.MISSING}
        given = {k: v for k, v in parameters.items() if k in known}
        made = TypeAdapter(cls).validate_python({**defaults, **given})
    except ValidationError as error:
        problems += [
            f"{at}.{'.'.join(str(p) for p in e['loc'])}: {e['msg']}; found {shown(repr(e['input']))}"
            for e in error.errors()
        ]
        return None
    except DanceDataError as error:
        problems.append(f"{at}: {error}")
        return None
    return None if unknown else made


def one_of(registry: Registry[P], where: str, given: Any, problems: list[str]) -> P | None:
    """Make the one plug-in of a slot, given as ``name`` or ``{name: {parameters}}``."""
    if isinstance(given, str):
        given = {given: {}}
    strange = [name for name in given if name not in registry] if isinstance(given, dict) else []
    if strange and len(given) - len(strange) == 1:
        # "dataset.split=all" where "dataset.aist++.split=all" was meant.
        meant = key_paths(registry, where, given)
        problems += [
            f"{where}.{shown(name)}: unknown key; {did_you_mean(str(name), registry.names(), meant)}"
            for name in strange
        ]
        return None
    if not isinstance(given, dict) or len(given) != 1:
        names = ", ".join(registry.names())
        problems.append(
            f"{where}: name one {registry.kind}, as in {{name: {{}}}}; known: {names}; found {shown(repr(given))}"
        )
        return None
    ((name, parameters),) = given.items()
    return make_plugin(registry, where, str(name), parameters, problems)


def copy_specs(given: Any, fields: Mapping[str, Columns], problems: list[str]) -> tuple[CopySpec, ...]:
    """Make the augmentations that a recipe names: ``{NAME: {parameters}}``, or ``{NAME: true}`` for the defaults.

    Parameters
    ----------
    fields
        Columns of the recipe's motion and key motion fields.
    problems
        What is wrong is added to it.
    """
    given = {given: {}} if isinstance(given, str) else given
    if given is not None and not isinstance(given, dict):
        problems.append(f"augment: must be a mapping such as {{mirror: true}}; found {shown(repr(given))}")
        return ()
    specs = []
    for name, parameters in (given or {}).items():
        own = {} if isinstance(parameters, bool) else parameters
        made = make_instance(AUGMENTATIONS, "augment", str(name), own, problems)
        if made is None or parameters is False:
            continue
        if not isinstance(made, CopyAugmentation):
            problems.append(
                f"augment.{name}: it makes no copies: it changes samples when a dataset is read; "
                f"fix: WindowDataset(..., augment=[{made.name!r}])"
            )
            continue
        for field, columns in fields.items():
            try:
                made.check(columns)
            except UsageError as error:
                problems.append(f"augment.{name}: field {field}: {error}")
        specs.append(CopySpec(str(name), made))
    # By name, as the recipe's hash does not depend on the order.
    return tuple(sorted(specs, key=lambda spec: spec.name))

"""The plug-ins of a recipe, made from their names and parameters: one slot after the other."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from dancedata.core.columns import Columns
from dancedata.core.errors import DanceDataError, RecipeError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.plugin_files import without_file_key
from dancedata.core.plugins import CopyAugmentation, Dataset, Plugin, WindowFilter
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
from dancedata.core.text import shown
from dancedata.recipes.copies import CopySpec
from dancedata.recipes.fields import FeatureJob, FieldSpec, KeyMotionField, MotionField, WindowSpec

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

F = TypeVar("F", bound=FieldSpec)
P = TypeVar("P", bound=Plugin)
R = TypeVar("R")
T = TypeVar("T", bound="DataclassInstance")

#: Registry of each slot, by its key in a recipe.
SLOTS: dict[str, Registry[Any]] = {
    "dataset": DATASETS,
    "motion": REPRESENTATIONS,
    "audio": FEATURES,
    "keymotion": KEYMOTIONS,
    "augment": AUGMENTATIONS,
}
#: Keys of a slot in addition to the plug-in's.
_SLOT_KEYS = {"motion": ("contacts", "optional"), "audio": ("fps",), "keymotion": ("optional",)}
#: Motion is resampled to a recipe's rate however slowly it was captured: a billion per second would fill any memory.
MAX_FPS = 1000
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


@dataclasses.dataclass(frozen=True)
class Slots:
    """The plug-ins of a recipe; None where there is a problem."""

    dataset: Dataset | None
    windows: WindowSpec | None
    motion: tuple[MotionField, ...]
    keymotion: tuple[KeyMotionField, ...]
    audio: tuple[FeatureJob, ...]
    augment: tuple[CopySpec, ...]


def make_slots(
    document: Mapping[str, Any],
    grid: FrameGrid | None,
    windows: WindowSpec | None,
    *,
    by_window: bool,
    problems: Problems,
) -> Slots:
    """Make all plug-ins of a recipe document.

    `grid`, `windows`: None if they are wrong; fields are checked all the same, so that their errors come in the same
        message.
    `by_window`: Whether features are computed by window.
    """
    any_grid = grid or FrameGrid.of(30)
    dataset = one_of(DATASETS, "dataset", document.get("dataset"), problems)
    motion = _motion_fields(document.get("motion"), any_grid, problems)
    keymotion = _key_motion_fields(document.get("keymotion"), any_grid, problems)
    columns = {field.name: field.columns for field in (*motion, *keymotion)}
    augment = _copy_specs(document.get("augment"), columns, problems)
    if windows is not None:
        chosen = _window_filter(document["windows"].get("filter"), columns, problems)
        windows = dataclasses.replace(windows, filter=chosen)
        may_lack = {field.name for field in (*motion, *keymotion) if field.optional}
        if chosen is not None and chosen.field in may_lack:
            problems.append(
                f"windows.filter.{chosen.name}: {chosen.field} is optional, and clips without it cannot be filtered; "
                "fix: name a field that every clip has"
            )
    audio = _feature_jobs(document.get("audio"), any_grid, windows if by_window else None, problems)
    problems += _optional_problems(motion, keymotion, by_window=by_window)
    if windows is not None:
        for field in (*motion, *audio):
            problems.catch(partial(field.require_whole, windows))
    timed = [spec.name for spec in augment if spec.augmentation.changes == "time"]
    for job in audio:
        if timed and job.feature.from_files:
            problems.append(
                f"audio.{job.name}: rows from files have no copies at another speed; "
                f"fix: leave out augment.{timed[0]}, or the field"
            )
        if augment and job.feature.of_motion:
            problems.append(
                f"audio.{job.name}: rows of motion from files have no copies: a copy needs files of its own; "
                f"fix: leave out augment.{augment[0].name}, or the field"
            )
    for job in audio if grid is not None else ():
        # A rate that a feature cannot compute at is an error now, not after all music was decoded.
        problems.catch(partial(job.feature.n_rows, 1, 48_000, job.grid), f"audio.{job.name}: ")
    return Slots(dataset, windows, motion, keymotion, audio, augment)


def frame_grid(fps: Any, key: str = "fps") -> FrameGrid:
    """Return the grid of a rate in a recipe.

    Raises UsageError: if it is not a number above 0, or above MAX_FPS.
    """
    try:
        # A boolean is a number to Python.
        grid = FrameGrid.of(repr(fps) if fps is None or isinstance(fps, bool) else fps)
    except UsageError as error:
        raise UsageError(f"{key}: {error}") from error
    if grid.rate > MAX_FPS:
        raise UsageError(
            f"{key} is too high", found=shown(str(grid), 40), allowed=f"at most {MAX_FPS:,} frames per second"
        )
    return grid


def _motion_fields(slot: Any, grid: FrameGrid, problems: Problems) -> tuple[MotionField, ...]:
    if not isinstance(slot, (dict, str)) or not slot:
        names = slot if isinstance(slot, list) and all(isinstance(name, str) for name in slot) else []
        example = ", ".join(f"{shown(name)}: {{}}" for name in names or ["edge151"])
        problems.append(f"motion: name at least one representation, such as {{{example}}}; found {shown(repr(slot))}")
        return ()
    fields = []
    for name, representation, keys in _instances(REPRESENTATIONS, "motion", slot, problems):
        if representation is None:
            continue
        rule = keys.get("contacts")
        default = representation.default_contacts
        rule = default if rule is None else rule
        if rule is not None and default is None:
            problems.append(f"motion.{name}.contacts: {name} has no contact columns")
        contacts = None if rule is None else one_of(CONTACTS, f"motion.{name}.contacts", rule, problems)
        rate = representation.rate
        of_rate = grid if rate is None else FrameGrid(rate)
        optional = _is_optional(f"motion.{name}", keys, problems)
        fields.append(MotionField(name, of_rate, representation, contacts, optional=optional))
    return _by_name(fields)


def _is_optional(where: str, keys: Mapping[str, Any], problems: Problems) -> bool:
    optional = keys.get("optional", False)
    if not isinstance(optional, bool):
        problems.append(f"{where}.optional: must be true or false; found {shown(repr(optional))}")
    return optional is True


def _optional_problems(
    fields: Sequence[MotionField], keymotion: Sequence[KeyMotionField], *, by_window: bool
) -> list[str]:
    """Return why fields of motion and key motions cannot be optional."""
    optional = [field for field in fields if field.optional]
    problems = []
    for field in (*optional, *(field for field in keymotion if field.optional)) if by_window else ():
        problems.append(f"{field.kind}.{field.name}.optional: clips without a field need scope: track")
    if optional and len(optional) == len(fields):
        problems.append("motion: all fields are optional; fix: one field has to be there for every clip")
    for field in optional:
        if field.representation.name == "root_place":
            problems.append(f"motion.{field.name}.optional: the places of dancers cannot be left out")
    return problems


def _feature_jobs(
    slot: Any, grid: FrameGrid, windows: WindowSpec | None, problems: Problems
) -> tuple[FeatureJob, ...]:
    jobs = []
    for name, feature, keys in _instances(FEATURES, "audio", slot, problems):
        fps = keys.get("fps")
        rows = grid if fps is None else problems.catch(partial(frame_grid, fps, f"audio.{name}.fps"))
        if feature is not None and rows is not None:
            jobs.append(FeatureJob(name, rows, feature, windows, rows != grid))
    return _by_name(jobs)


def _key_motion_fields(slot: Any, grid: FrameGrid, problems: Problems) -> tuple[KeyMotionField, ...]:
    return _by_name(
        [
            KeyMotionField(name, grid, finder, optional=_is_optional(f"keymotion.{name}", keys, problems))
            for name, finder, keys in _instances(KEYMOTIONS, "keymotion", slot, problems)
            if finder is not None
        ]
    )


def _copy_specs(slot: Any, fields: Mapping[str, Columns], problems: Problems) -> tuple[CopySpec, ...]:
    """Make the augmentations that a recipe names: ``{NAME: {parameters}}``, or ``{NAME: true}`` for the defaults."""
    if slot is not None and not isinstance(slot, dict | str):
        problems.append(f"augment: must be a mapping such as {{mirror: true}}; found {shown(repr(slot))}")
        return ()
    specs = []
    for key, value in ({slot: True} if isinstance(slot, str) else slot or {}).items():
        name, parameters = str(key), {} if isinstance(value, bool) else value
        augmentation = make_plugin(AUGMENTATIONS, "augment", name, parameters, problems, several=True)
        if augmentation is None or value is False:
            continue
        if not isinstance(augmentation, CopyAugmentation):
            problems.append(
                f"augment.{name}: it makes no copies: it changes samples when a dataset is read; "
                f"fix: WindowDataset(..., augment=[{augmentation.name!r}])"
            )
            continue
        for field, columns in fields.items():
            problems.catch(partial(augmentation.check, columns), f"augment.{name}: field {field}: ")
        specs.append(CopySpec(name, augmentation))
    return tuple(sorted(specs, key=lambda spec: spec.name))


def _window_filter(slot: Any, fields: Mapping[str, Columns], problems: Problems) -> WindowFilter | None:
    window_filter = None if slot is None else one_of(FILTERS, "windows.filter", slot, problems)
    if window_filter is None:
        return None
    field, where = window_filter.field, f"windows.filter.{window_filter.name}"
    if field not in fields:
        meant = did_you_mean(field, fields)
        default = " (the default)" if field == getattr(type(window_filter), "field", None) else ""
        problems.append(f"{where}.field: no such field in motion or keymotion: {shown(field)}{default}; {meant}")
        return None
    problems.catch(partial(window_filter.check, fields[field]), f"{where}: field {field}: ")
    return window_filter


def _instances(
    registry: Registry[P], slot: str, plugins: Any, problems: Problems
) -> Iterator[tuple[str, P | None, dict[str, Any]]]:
    """Yield name, plug-in (None if it is wrong) and the values of the slot's keys for each entry of a slot."""
    also = _SLOT_KEYS.get(slot, ())
    if not isinstance(plugins, dict):
        plugins = {str(plugins): {}} if plugins else {}
    for key, parameters in plugins.items():
        name = str(key)  # in YAML a key may be a number
        keys: dict[str, Any] = {}
        if also and isinstance(parameters, dict):
            keys = {key: parameters[key] for key in also if key in parameters}
            parameters = {key: value for key, value in parameters.items() if key not in keys}
        yield name, make_plugin(registry, slot, name, parameters, problems, beside=plugins, several=True), keys


def _by_name(fields: Sequence[F]) -> tuple[F, ...]:
    # The recipe's hash does not depend on the order.
    return tuple(sorted(fields, key=lambda field: field.name))


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
    """Make one plug-in. If there are problems, all of them are added to the list, and None is returned.

    `where`: Key of the slot.
    `beside`: All that the slot holds: if `name` is not a plug-in, it may be a misplaced key of one of these.
    `several`: Whether the slot takes several of one plug-in, named PLUGIN.NAME.
    """
    also = _SLOT_KEYS.get(where, ()) if several else ()
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
    return make_dataclass(cls, f"{where}.{name}", parameters, problems, also)


def one_of(registry: Registry[P], where: str, plugin: Any, problems: list[str]) -> P | None:
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
    """Make one plug-in for a call from Python, where a problem is raised at once.

    Raises UsageError: for an unknown name.
    Raises RecipeError: for parameters that it does not take, all of them.
    """
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
        problems.append(f"{where}: {error}")
        return None
    return None if unknown else _with_whole_paths(plugin)


def _with_whole_paths(plugin: T) -> T:
    """Return a plug-in whose paths begin at the root: workers of a cluster run in other folders."""
    paths = {f.name: getattr(plugin, f.name) for f in dataclasses.fields(plugin) if f.metadata.get("path")}
    # os.path leaves the home of an unknown user as it is; what reads the path then names it.
    whole = {k: Path(os.path.expanduser(p)).absolute() for k, p in paths.items() if isinstance(p, Path)}
    return dataclasses.replace(plugin, **whole) if whole else plugin


def slot_keys(document: Mapping[str, Any]) -> Iterator[str]:
    """Yield the keys of all plug-ins that a document names, as --set takes them."""
    yield from _key_paths(AUGMENTATIONS, "augment", dict.fromkeys(AUGMENTATIONS.names()))
    for slot, registry in SLOTS.items():
        yield from _key_paths(registry, slot, document.get(slot))


def _key_paths(registry: Registry[P], where: str, plugins: Any) -> Iterator[str]:
    """Yield the keys of the plug-ins that a slot names, as --set takes them: "audio.librosa35.tightness"."""
    for name in [plugins] if isinstance(plugins, str) else plugins if isinstance(plugins, dict) else ():
        plugin, _ = registry.split(str(name))
        if plugin in registry:
            keys = [f.name for f in dataclasses.fields(registry.get(plugin))]
            yield f"{where}.{name}"
            yield from (f"{where}.{name}.{key}" for key in (*keys, *_SLOT_KEYS.get(where, ())))

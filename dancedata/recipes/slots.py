"""The slots of a recipe: all its plug-ins, made from the document, and whether they fit together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

from dancedata.building.fields.motion import MotionField, RepresentationField
from dancedata.building.fields.music import FeatureField, MusicField
from dancedata.building.plugins import Annotator, Field, WindowRule
from dancedata.building.take import Transform
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid, WindowSpec
from dancedata.core.plugin_files import unknown_plugin
from dancedata.core.plugins import Dataset, Plugin
from dancedata.core.registry import (
    ANNOTATORS,
    AUGMENTATIONS,
    CONTACTS,
    DATASETS,
    FEATURES,
    FIELDS,
    FILTERS,
    KEYMOTIONS,
    REPRESENTATIONS,
    RULES,
    TRANSFORMS,
    Registry,
)
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import shown
from dancedata.recipes.plugins import (
    ALWAYS,
    SLOT_KEYS,
    Problems,
    frame_grid,
    make_plugin,
    named_entries,
    single_plugin,
)
from dancedata.store.schema import ORIGINAL

if TYPE_CHECKING:
    from dancedata.building.transforms.copy import Copy
    from dancedata.core.plugins import FileFeature

P = TypeVar("P", bound=Plugin)
N = TypeVar("N", bound=Any)
_EXAMPLES = {
    "augment": "{mirror: true}",
    "annotators": "{facts: true}",
    "fields": "{NAME: true}",
    "rules": "{curate: {spikes: true}}",
}


@dataclasses.dataclass(frozen=True)
class Slots:
    """The plug-ins of a recipe; None where there is a problem."""

    dataset: Dataset | None
    transforms: tuple[Transform, ...]
    fields: tuple[Field, ...]
    augment: tuple[Copy, ...]
    annotators: tuple[Annotator, ...]
    rules: tuple[WindowRule, ...]


def make_slots(
    document: Mapping[str, Any], grid: FrameGrid | None, windows: WindowSpec | None, problems: Problems
) -> Slots:
    """Make all plug-ins of a recipe document; `grid` or `windows` is None if it is wrong: all others are checked."""
    any_grid = grid or FrameGrid.of(30)
    dataset = single_plugin(DATASETS, "dataset", document.get("dataset"), problems)
    transforms = _transforms(document.get("transforms"), problems)
    motion = _motion_fields(document.get("motion"), any_grid, problems)
    keymotion = _key_motion_fields(document.get("keymotion"), any_grid, problems)
    steps = [problems.catch(partial(step.on, any_grid), "transforms.") for step in transforms]
    excerpts = next((step.excerpts for step in steps if step is not None and step.excerpts is not None), None)
    audio = _feature_fields(document.get("audio"), any_grid, excerpts, problems)
    fields = (*motion, *keymotion, *audio, *_plugin_fields(document.get("fields"), any_grid, problems))
    augment = _copies(document.get("augment"), motion, problems)
    annotators = _annotators(document.get("annotators"), problems)
    rules = _rules(document.get("rules"), problems)
    for slot, parts in (("transforms", transforms), ("augment", augment), ("rules", rules)):
        for plugin in parts:
            problems.catch(partial(plugin.check, fields), f"{slot}.")
    problems += _optional_problems(motion)
    for lengths in filter(None, (windows, excerpts)):
        for field in fields:
            problems.catch(partial(field.require_whole, lengths))
    if windows is not None and excerpts is not None and windows.length > excerpts.length:
        problems.append(f"windows: {windows.length_s:g} s are longer than the slices; found {excerpts.length_s:g} s")
    timed = [copy.name for copy in augment if not copy.keeps_time]
    for song_field in audio:
        if timed and song_field.from_files:
            problems.append(
                f"audio.{song_field.name}: rows from files have no copies at another speed; "
                f"fix: leave out augment.{timed[0]}, or the field"
            )
        if augment and song_field.feature.of_motion:
            problems.append(
                f"audio.{song_field.name}: rows of motion from files have no copies: a copy needs files of its own; "
                f"fix: leave out augment.{augment[0].name}, or the field"
            )
    for song_field in audio if grid is not None else ():
        # A rate that a feature cannot compute at is an error now, not after all music was decoded.
        problems.catch(partial(song_field.feature.n_rows, 1, 48_000, song_field.grid), f"audio.{song_field.name}: ")
    originals = problems.catch(partial(_originals, motion, fields, transforms)) or ()
    fields = (*_by_name([*motion, *originals]), *fields[len(motion) :])
    return Slots(dataset, transforms, fields, augment, annotators, rules)


def _motion_fields(slot: Any, grid: FrameGrid, problems: Problems) -> tuple[RepresentationField, ...]:
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
        contacts = None if rule is None else single_plugin(CONTACTS, f"motion.{name}.contacts", rule, problems)
        row_grid = grid if representation.rate is None else FrameGrid(representation.rate)
        optional = _is_optional(f"motion.{name}", keys, problems)
        fields.append(RepresentationField(name, row_grid, representation, contacts, optional=optional))
    return _by_name(fields)


def _is_optional(where: str, keys: Mapping[str, Any], problems: Problems) -> bool:
    optional = keys.get("optional", False)
    if not isinstance(optional, bool):
        problems.append(f"{where}.optional: must be true or false; found {shown(repr(optional))}")
    return optional is True


def _optional_problems(fields: Sequence[RepresentationField]) -> list[str]:
    """Return why fields of motion cannot be optional."""
    optional = [field for field in fields if field.optional]
    problems = []
    if optional and len(optional) == len(fields):
        problems.append("motion: all fields are optional; fix: one field has to be there for every clip")
    for field in optional:
        if field.representation.holds_places:
            problems.append(f"motion.{field.name}.optional: the places of dancers cannot be left out")
    return problems


def _feature_fields(
    slot: Any, grid: FrameGrid, windows: WindowSpec | None, problems: Problems
) -> tuple[FeatureField, ...]:
    fields: list[FeatureField] = []
    for name, feature, keys in _instances(FEATURES, "audio", slot, problems):
        fps = keys.get("fps")
        row_grid = grid if fps is None else problems.catch(partial(frame_grid, fps, f"audio.{name}.fps"))
        if feature is not None and row_grid is not None:
            own_rate = row_grid != grid
            if feature.from_files:
                from dancedata.building.fields.files import FileField

                fields.append(FileField(name, row_grid, cast("FileFeature", feature), own_rate=own_rate))
            else:
                fields.append(MusicField(name, row_grid, feature, own_rate, windows))
    return _by_name(fields)


def _plugin_fields(slot: Any, grid: FrameGrid, problems: Problems) -> tuple[Field, ...]:
    fields = [
        problems.catch(partial(_on, field, grid), f"fields.{name}: ")
        for name, field in _switched((FIELDS,), "fields", slot, problems)
    ]
    return _by_name([field for field in fields if field is not None])


def _on(field: Field, grid: FrameGrid) -> Field:
    """Return a field for a recipe of this rate; UsageError for a rate that is not possible."""
    field = field.on(grid)
    frame_grid(str(field.grid))
    return field


def _key_motion_fields(slot: Any, grid: FrameGrid, problems: Problems) -> tuple[MotionField, ...]:
    if not slot:
        return ()
    from dancedata.building.fields.key_motion import KeyMotionField

    return _by_name(
        [
            KeyMotionField(name, grid, finder, optional=_is_optional(f"keymotion.{name}", keys, problems))
            for name, finder, keys in _instances(KEYMOTIONS, "keymotion", slot, problems)
            if finder is not None
        ]
    )


def _originals(
    motion: Sequence[RepresentationField], fields: Sequence[Field], transforms: Sequence[Transform]
) -> list[RepresentationField]:
    """Return one more field for each of motion, without the transforms that keep the original."""
    without = tuple(step.name for step in transforms if step.keeps_original)
    originals = [dataclasses.replace(f, name=f"{f.name}{ORIGINAL}", without=without) for f in motion if without]
    taken = {field.name for field in fields} & {field.name for field in originals}
    if taken:
        raise UsageError(f"motion.{min(taken)}: this is the name of the field with the motion before {without[0]}",
                         fix=f"give it another name, or set {without[0]}.original to false")  # fmt: skip
    return originals


def _transforms(slot: Any, problems: Problems) -> tuple[Transform, ...]:
    """Make the chain of transforms: a list of names, or of ``{NAME: {parameters}}``."""
    entries = [slot] if isinstance(slot, str) else [] if slot is None else slot
    single = isinstance(entries, list) and all(
        isinstance(e, str) or (isinstance(e, dict) and len(e) == 1) for e in entries
    )
    if not single:
        problems.append(
            "transforms: must be a list, in the order in which motion goes through them, such as "
            f"[{{retarget: {{skeleton: smpl24}}}}]; found {shown(repr(slot))}"
        )
        return ()
    named = named_entries(entries)
    if len(named) < len(entries):
        problems.append(f"transforms: a transform is named twice; found {shown(repr(slot))}")
    return tuple(step for _, step in _switched((TRANSFORMS,), "transforms", named, problems))


def _copies(slot: Any, motion: Sequence[RepresentationField], problems: Problems) -> tuple[Copy, ...]:
    if slot is None:
        return ()
    from dancedata.building.transforms.copy import Copy
    from dancedata.core.plugins import CopyAugmentation

    body = max((field.representation.skeleton for field in motion), key=lambda s: s.n_joints, default=SMPL24)
    copies = []
    for name, augmentation in _switched((AUGMENTATIONS,), "augment", slot, problems, several=True):
        if isinstance(augmentation, CopyAugmentation):
            copies.append(Copy(name, augmentation, tuple(body.other_side.items())))
        else:
            problems.append(
                f"augment.{name}: it makes no copies: it changes samples when a dataset is read; "
                f"fix: WindowDataset(..., augment=[{augmentation.name!r}])"
            )
    return _by_name(copies)


def _annotators(slot: Any, problems: Problems) -> tuple[Annotator, ...]:
    named = dict(_switched((ANNOTATORS,), "annotators", slot, problems))
    problems += [
        f"annotators.{name}: its segments are not stored; fix: leave it out: what needs them has it by itself"
        for name, annotator in named.items()
        if not annotator.stored and name not in ALWAYS
    ]
    return _by_name([*named.values(), *(ANNOTATORS.make(name, {}) for name in ALWAYS if name not in named)])


def _rules(slot: Any, problems: Problems) -> tuple[WindowRule, ...]:
    if slot is None:
        return ()
    chosen = [plugin for _, plugin in _switched((RULES, FILTERS), "rules", slot, problems)]
    return _by_name([rule if isinstance(rule, WindowRule) else _filtered(rule) for rule in chosen])


def _filtered(window_filter: Any) -> WindowRule:
    from dancedata.building.rules.filtered import Filtered

    return Filtered(window_filter)


def _switched(
    registries: Sequence[Registry[Any]], slot: str, entries: Any, problems: Problems, *, several: bool = False
) -> Iterator[tuple[str, Any]]:
    """Yield name and plug-in of each entry, ``{NAME: {parameters}}`` or ``{NAME: true}``; check those with false."""
    if entries is not None and not isinstance(entries, dict | str):
        problems.append(f"{slot}: must be a mapping such as {_EXAMPLES[slot]}; found {shown(repr(entries))}")
        return
    for key, value in named_entries(entries).items():
        name, parameters = str(key), {} if isinstance(value, bool) else value
        registry = next((r for r in registries if name in r), registries[0])
        if len(registries) > 1 and name not in registry:
            names = sorted(plugin for r in registries for plugin in r.names())
            problems.append(f"{slot}: {unknown_plugin(registry.kind, name, parameters, names)}")
            continue
        plugin = make_plugin(registry, slot, name, parameters, problems, beside=entries, several=several)
        if plugin is not None and value is not False:
            yield name, plugin


def _instances(
    registry: Registry[P], slot: str, entries: Any, problems: Problems
) -> Iterator[tuple[str, P | None, dict[str, Any]]]:
    """Yield name, plug-in (None if it is wrong) and the values of the slot's keys for each entry of a slot."""
    also = SLOT_KEYS.get(slot, ())
    if not isinstance(entries, dict):
        entries = {str(entries): {}} if entries else {}
    for key, parameters in entries.items():
        name = str(key)  # in YAML a key may be a number
        keys: dict[str, Any] = {}
        if also and isinstance(parameters, dict):
            keys = {key: parameters[key] for key in also if key in parameters}
            parameters = {key: value for key, value in parameters.items() if key not in keys}
        yield name, make_plugin(registry, slot, name, parameters, problems, beside=entries, several=True), keys


def _by_name(named: Sequence[N]) -> tuple[N, ...]:
    # The recipe's hash does not depend on the order.
    return tuple(sorted(named, key=lambda one: one.name))

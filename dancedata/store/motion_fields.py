"""Columns of a dataset's motion fields back to poses, by the plug-ins that its recipe names."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from dancedata.core.columns import Columns
from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation, SampleField
from dancedata.core.registry import CONTACTS, REPRESENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.store.row_queries import RowQueries

#: End of the name of a field with the motion as it was before the recipe's repairs.
ORIGINAL = ".original"
_POSITION = "position"
#: Keys of a motion field in a recipe that are not parameters of its representation.
_NOT_OF_PLUGIN = ("contacts", "optional")


def _entry(recipe: object, field: str) -> dict[str, Any]:
    """Return a recipe's entry of a motion field; empty for anything else."""
    motion = recipe.get("motion") if isinstance(recipe, Mapping) else None
    # A field with the motion before repairs has the parameters of the repaired one.
    entry = motion.get(field, motion.get(field.removesuffix(ORIGINAL))) if isinstance(motion, Mapping) else None
    return dict(entry) if isinstance(entry, Mapping) else {}


def stored_representation(recipe: object, field: str, columns: Columns) -> Representation:
    """Return the plug-in that made the columns of a motion field, with the parameters of the dataset's recipe.

    Without an entry for the field, PLUGIN or PLUGIN.NAME, the plug-in has its default parameters. `columns` are those
    that are stored: a dataset may come from elsewhere. UsageError if no installed plug-in makes them, with the
    reason.
    """
    parameters = {key: value for key, value in _entry(recipe, field).items() if key not in _NOT_OF_PLUGIN}
    try:
        representation = REPRESENTATIONS.make(REPRESENTATIONS.split(field)[0], parameters)
        if representation.columns.to_json() != columns.to_json():
            raise UsageError(f"the installed {representation.name} makes other columns")
    except (DanceDataError, TypeError, ValueError, LookupError, ArithmeticError, AttributeError) as error:
        raise UsageError(
            f"the columns of {field} cannot be read", found=str(error),
            fix="install the version of the plug-in that the dataset was built with",
        ) from error  # fmt: skip
    return representation


def stored_contacts(recipe: object, field: str) -> ContactRule | None:
    """Return the rule of a field's contact columns; None where the recipe names none, or none that is installed."""
    rules = _entry(recipe, field).get("contacts")
    if not isinstance(rules, Mapping) or len(rules) != 1:
        return None
    ((name, parameters),) = rules.items()
    try:
        return CONTACTS.make(str(name), parameters) if isinstance(parameters, Mapping) else None
    except (DanceDataError, TypeError, ValueError):
        return None


def sample_field(store: RowQueries, name: str) -> SampleField:
    """Return a field with the plug-ins that made it, if the dataset's recipe names installed ones."""
    field, recipe = store.field(name), store.info.get("recipe")
    plain = SampleField(name, field.kind, field.columns, field.grid)
    if field.kind != "motion":
        return plain
    try:
        representation, contacts = stored_representation(recipe, name, field.columns), stored_contacts(recipe, name)
    except UsageError:
        return plain
    if representation.default_contacts is not None and contacts is None:
        return plain
    return replace(plain, representation=representation, contacts=contacts)


def stored_representations(store: RowQueries) -> dict[str, Representation]:
    """Return the plug-in of each motion field for which one is installed, in the order of the dataset."""
    representations = {}
    for field in store.fields_with(kind="motion"):
        with suppress(UsageError):  # `stored_representation` of this field raises the reason
            recipe = store.info.get("recipe")
            representations[field.name] = stored_representation(recipe, field.name, field.columns)
    return representations


def clip_motion(store: RowQueries, clip_id: str, field: str = "") -> Motion:
    """Return the motion of a whole clip; UsageError as `clip_joints`, and for a field without rotations."""
    name, plugin = _field_of_clip(store, clip_id, field)
    if not plugin.decodes:
        raise UsageError("the field has no rotations", where=str(store.path),
                         found=field or "fields of positions alone", fix="take clip.joints()")  # fmt: skip
    try:
        return plugin.decode(store._read_clip(clip_id, name), store.field(name).grid)
    except DataError as error:
        error.where = ": ".join(str(place) for place in (clip_id, error.where) if place is not None)
        raise


def clip_joints(store: RowQueries, clip_id: str, field: str = "") -> Float64Array:
    """Return the joints (T, J, 3) of a whole clip, by the field named, else the first with rotations, else positions.

    UsageError as `stored_representation`, and for a dataset without such a field.
    """
    name, plugin = _field_of_clip(store, clip_id, field)
    if plugin.decodes:
        return clip_motion(store, clip_id, name).joints()
    rows = store._read_clip(clip_id, name)
    return rows[:, plugin.columns.slice(_POSITION)].reshape(len(rows), -1, 3).astype(np.float64)


def _field_of_clip(store: RowQueries, clip_id: str, field: str) -> tuple[str, Representation]:
    if field:
        return field, stored_representation(store.info.get("recipe"), field, store.field(field).columns)
    kept = {
        name: plugin
        for name, plugin in stored_representations(store).items()
        if (plugin.decodes or _POSITION in plugin.columns.names) and store._has_field(clip_id, name)
    }
    if not kept:
        raise UsageError("the dataset has no field of motion that can be decoded", where=str(store.path),
                         found=", ".join(store.fields))  # fmt: skip
    return min(kept.items(), key=lambda item: not item[1].decodes)

"""Columns of a dataset's motion fields back to poses, by the plug-ins that its recipe names."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from dancedata.core.columns import Columns
from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.plugins import ContactRule, Representation, SampleField
from dancedata.core.registry import CONTACTS, REPRESENTATIONS
from dancedata.store.row_queries import RowQueries
from dancedata.store.schema import ORIGINAL

#: Keys of a motion field in a recipe that are not parameters of its representation.
_NOT_OF_PLUGIN = ("contacts", "optional")


def _entry(recipe: object, field: str) -> dict[str, Any]:
    """Return a recipe's entry of a motion field; empty for anything else."""
    motion = recipe.get("motion") if isinstance(recipe, Mapping) else None
    # A field with the motion before repairs has the parameters of the repaired one.
    entry = motion.get(field, motion.get(field.removesuffix(ORIGINAL))) if isinstance(motion, Mapping) else None
    return dict(entry) if isinstance(entry, Mapping) else {}


def stored_representation(recipe: object, field: str, columns: Columns) -> Representation:
    """Return the plug-in that made stored columns, by the dataset's recipe; UsageError if none installed does."""
    parameters = {key: value for key, value in _entry(recipe, field).items() if key not in _NOT_OF_PLUGIN}
    try:
        representation = REPRESENTATIONS.make(REPRESENTATIONS.split(field)[0], parameters)
        if representation.columns.to_json() != columns.to_json():
            raise UsageError(f"the installed {representation.name} now makes different columns")
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

"""The slot `augment` of a recipe: which copies of train clips are stored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.text import shown
from dancedata.recipes.copies import CopySpec
from dancedata.recipes.plugins import make_instance


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
        if not made.makes_copies:
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

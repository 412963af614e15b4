"""The fields of a dataset as augmentations of samples see them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dancedata.core.errors import DanceDataError
from dancedata.core.plugins import ContactRule, Representation, SampleField
from dancedata.core.registry import CONTACTS, REPRESENTATIONS, Registry
from dancedata.readers.named_plugins import named_plugin
from dancedata.store.dataset import Store


def sample_fields(store: Store, names: Sequence[str]) -> tuple[SampleField, ...]:
    """Return fields with the representations that made them, where the dataset's recipe names them."""
    return tuple(_sample_field(store, name) for name in names)


def _sample_field(store: Store, name: str) -> SampleField:
    field = store.field(name)
    plain = SampleField(name, field.kind, field.columns, field.grid)
    parameters = _parameters(store.meta, name) if field.kind == "motion" else None
    if parameters is None:
        return plain
    rules = parameters.pop("contacts", None)
    representation: Representation | None = _made(REPRESENTATIONS, name, parameters)
    # The dataset may come from elsewhere: what it names has to have made its columns.
    if representation is None or representation.columns.to_json() != field.columns.to_json():
        return plain
    contacts: ContactRule | None = None
    if isinstance(rules, Mapping) and len(rules) == 1:
        ((rule, own),) = rules.items()
        contacts = _made(CONTACTS, str(rule), own) if isinstance(own, Mapping) else None
    if representation.default_contacts is not None and contacts is None:
        return plain
    return SampleField(name, field.kind, field.columns, field.grid, representation, contacts)


def _parameters(meta: Mapping[str, Any], field: str) -> dict[str, Any] | None:
    """Return what the recipe of a dataset says of a motion field; None if it says nothing."""
    recipe = meta.get("recipe")
    motion = recipe.get("motion") if isinstance(recipe, Mapping) else None
    found = motion.get(field) if isinstance(motion, Mapping) else None
    return dict(found) if isinstance(found, Mapping) else None


def _made(registry: Registry[Any], name: str, parameters: Mapping[str, Any]) -> Any:
    """Return a plug-in, named PLUGIN or PLUGIN.NAME; None if this installation has none that takes the parameters."""
    plugin = name if name in registry.names() else name.partition(".")[0]
    try:
        return named_plugin(registry, plugin, parameters)
    except (DanceDataError, TypeError, ValueError):
        return None

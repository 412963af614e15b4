"""The fields of a dataset as augmentations of samples see them."""

from __future__ import annotations

from collections.abc import Sequence

from dancedata.core.errors import UsageError
from dancedata.core.plugins import SampleField
from dancedata.representations.stored import stored_motion
from dancedata.store.dataset import Store


def sample_fields(store: Store, names: Sequence[str]) -> tuple[SampleField, ...]:
    """Return fields with the plug-ins that made them, where the dataset's recipe names installed ones."""
    return tuple(_sample_field(store, name) for name in names)


def _sample_field(store: Store, name: str) -> SampleField:
    field = store.field(name)
    plain = SampleField(name, field.kind, field.columns, field.grid)
    if field.kind != "motion":
        return plain
    try:
        stored = stored_motion(store.meta.get("recipe"), name, field.columns)
    except UsageError:
        return plain
    if stored.representation.default_contacts is not None and stored.contacts is None:
        return plain
    return SampleField(name, field.kind, field.columns, field.grid, stored.representation, stored.contacts)

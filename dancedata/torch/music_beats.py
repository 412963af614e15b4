"""Labels of beats and downbeats of samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from dancedata.store.dataset import Store
from dancedata.store.schema import Field

#: Beats at which a window or crop may begin.
StartAt = Literal["beat", "downbeat"]
#: Labels of samples, and of the column groups that they come from.
LABELS: tuple[str, ...] = get_args(StartAt)


@dataclass(frozen=True)
class BeatLabels:
    """The field of samples that has beats and downbeats, and the column of each of `LABELS` in it."""

    field: str
    columns: tuple[int, ...]

    def of(self, rows: npt.NDArray[Any]) -> dict[str, npt.NDArray[np.bool_]]:
        """Return labels (L,) by name, from the stored rows (L, D) of the field."""
        return {name: rows[:, column] != 0 for name, column in zip(LABELS, self.columns, strict=True)}


def beat_labels(store: Store, fields: Sequence[str]) -> BeatLabels | None:
    """Return the first field with both labels; None without one, or if a field has the name of a label."""
    if set(LABELS) & set(fields):
        return None
    for field in preferred(store.fields_with(*LABELS), fields):
        if field.name in fields:
            return BeatLabels(field.name, tuple(field.columns.slice(label).start for label in LABELS))
    return None


def preferred(candidates: Sequence[Field], fields: Sequence[str]) -> list[Field]:
    """Return the candidates, sorted: those of `fields` come first, in that order."""
    order = {name: place for place, name in enumerate(fields)}
    return sorted(candidates, key=lambda field: order.get(field.name, len(order)))

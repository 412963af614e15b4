"""Checks of what augmentations do to samples, for the conformance suite."""

from __future__ import annotations

import numpy as np

from dancedata.core.columns import Columns, Group
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.plugins import SampleAugmentation, SampleField
from dancedata.testing.examples import FPS, ExampleField, example_fields
from dancedata.testing.require import require


def check_samples(made: SampleAugmentation) -> None:
    """Check `change_sample` on every field that `check_sample` accepts, and that refusals say why."""
    accepted = 0
    for field in example_fields():
        try:
            made.check_sample(field.sample_field)
        except UsageError as error:
            require(bool(str(error)), f"{field.name}: a refusal says why")
            continue
        accepted += field.kind == "motion"
        _check_sample(made, field)
    require(bool(accepted), "`check_sample` accepts a representation")


def _check_sample(made: SampleAugmentation, field: ExampleField) -> None:
    own, rows = field.sample_field, field.rows.copy()
    rows.setflags(write=False)
    low, high = rows.min(axis=0).astype(np.float64), rows.max(axis=0).astype(np.float64)
    for given in (rows, rows[:1]):
        for index in range(4):
            first, second = (made.change_sample(given, own, Draw(0, index)) for _ in range(2))
            require(
                first.shape == given.shape and first.dtype == given.dtype, f"{field.name}: shape and dtype are kept"
            )
            require(bool(np.isfinite(first).all()), f"{field.name}: samples are finite")
            require(np.array_equal(first, second), f"{field.name}: equal numbers give equal samples")
            below, above = made.scaler_bounds(low, high, own)
            if field.kind == "motion" and (below is not low or above is not high):
                inside = bool((first >= below - 1e-5).all() and (first <= above + 1e-5).all())
                require(inside, f"{field.name}: `scaler_bounds` holds for what change_sample returns")


def check_starts(made: SampleAugmentation) -> None:
    """Check `choose_start`; a window is kept unless the class declares that it chooses others."""
    if not made.chooses_windows:
        require(made.choose_start(10, range(4, 60, 2), 15, Draw(0)) == 10, "choose_start needs chooses_windows")
        return
    starts = range(4, 60, 2)
    for index in range(20):
        first, second = (made.choose_start(10, starts, 15, Draw(0, index)) for _ in range(2))
        require(first in starts, "choose_start returns one of starts")
        require(first == second, "equal numbers give equal windows")
    require(made.choose_start(4, range(4, 5), 15, Draw(0)) == 4, "a clip of one window has that window")


def check_drops(made: SampleAugmentation) -> None:
    """Check `droppable` and `dropped`."""
    music = SampleField("music", "audio", Columns((Group("level", 1, "1"),)), FPS)
    fields = [music, *(field.sample_field for field in example_fields())]
    names = made.droppable(fields)
    require(set(names) <= {field.name for field in fields}, "droppable names fields of the sample")
    for index in range(20):
        first, second = (made.dropped(fields, Draw(0, index)) for _ in range(2))
        require(
            set(first) <= set(names) and first == second, "dropped names some of them, the same for equal numbers"
        )

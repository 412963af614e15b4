"""Checks of plug-ins of every kind."""

import dataclasses
import inspect
import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Group
from dancedata.core.dance import OUTCOMES, Dance, Undefined
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Metric, SampleAugmentation, SampleField
from dancedata.core.registry import REGISTRIES, Registry
from dancedata.exports.base.job import EXPORTS
from dancedata.testing.examples import FPS, ExampleField, example_dances, example_fields


def check_samples(augmentation: SampleAugmentation) -> None:
    """Check `change_sample` on every field that `check_sample` accepts, and that refusals say why."""
    accepted = 0
    for field in example_fields():
        try:
            augmentation.check_sample(field.sample_field)
        except UsageError as error:
            require(bool(str(error)), f"{field.name}: a refusal says why")
            continue
        accepted += field.kind == "motion"
        _check_sample(augmentation, field)
    require(bool(accepted), "`check_sample` accepts a representation")


def _check_sample(augmentation: SampleAugmentation, field: ExampleField) -> None:
    sample_field, rows = field.sample_field, field.rows.copy()
    rows.setflags(write=False)
    low, high = rows.min(axis=0).astype(np.float64), rows.max(axis=0).astype(np.float64)
    for sample in (rows, rows[:1]):
        for index in range(4):
            first, second = (augmentation.change_sample(sample, sample_field, Draw(0, index)) for _ in range(2))
            require(
                first.shape == sample.shape and first.dtype == sample.dtype, f"{field.name}: shape and dtype are kept"
            )
            require(bool(np.isfinite(first).all()), f"{field.name}: samples are finite")
            require(np.array_equal(first, second), f"{field.name}: equal numbers give equal samples")
            below, above = augmentation.scaler_bounds(low, high, sample_field)
            if field.kind == "motion" and (below is not low or above is not high):
                inside = bool((first >= below - 1e-5).all() and (first <= above + 1e-5).all())
                require(inside, f"{field.name}: `scaler_bounds` holds for what change_sample returns")


def check_starts(augmentation: SampleAugmentation) -> None:
    """Check `choose_start`; a window is kept unless the class declares that it chooses others."""
    if not augmentation.chooses_windows:
        require(
            augmentation.choose_start(10, range(4, 60, 2), 15, Draw(0)) == 10, "choose_start needs chooses_windows"
        )
        return
    starts = range(4, 60, 2)
    for index in range(20):
        first, second = (augmentation.choose_start(10, starts, 15, Draw(0, index)) for _ in range(2))
        require(first in starts, "choose_start returns one of starts")
        require(first == second, "equal numbers give equal windows")
    require(augmentation.choose_start(4, range(4, 5), 15, Draw(0)) == 4, "a clip of one window has that window")


def check_drops(augmentation: SampleAugmentation) -> None:
    """Check `droppable` and `dropped`."""
    music = SampleField("music", "audio", Columns((Group("level", 1, "1"),)), FPS)
    fields = [music, *(field.sample_field for field in example_fields())]
    names = augmentation.droppable(fields)
    require(set(names) <= {field.name for field in fields}, "droppable names fields of the sample")
    for index in range(20):
        first, second = (augmentation.dropped(fields, Draw(0, index)) for _ in range(2))
        require(
            set(first) <= set(names) and first == second, "dropped names some of them, the same for equal numbers"
        )


def check_metric(cls: type[Metric]) -> None:
    """Check a metric: finite numbers or a named outcome, equal dances get equal numbers, scores, order of clips."""
    check_plugin(cls)
    metric = cls()
    width = len(metric.columns)
    require(bool(cls.source), "source names the origin of the definition")
    require(width > 0 and len(set(metric.columns)) == width, "every number of a clip has a unique name")
    dances = example_dances()
    if cls.of_groups:  # a duet of each dance with its mirror image, two metres away
        pairs = [np.stack([dance.joints, dance.joints * (-1, 1, 1) + (2, 0, 0)]) for dance in dances]
        dances = [dataclasses.replace(dance, joints=pair) for dance, pair in zip(dances, pairs, strict=True)]
    rows = [row for row in (_measured(metric, dance) for dance in dances) if row is not None]
    require(len(rows) >= 2, "ordinary dances have values")
    table = np.array(rows)
    before = table.copy()
    scores = metric.summarise(table, table if cls.needs_pool else None)
    require(np.array_equal(table, before), "summarise does not write into the rows")
    require(bool(scores) and all(np.isfinite(value) for value in scores.values()), "scores are finite numbers")
    require(set(cls.better) <= scores.keys(), f"better names scores: {', '.join(scores)}")
    require(bool(cls.better), "better gives the better direction of a score")
    turned = metric.summarise(table[::-1], table[::-1] if cls.needs_pool else None)
    close = scores.keys() == turned.keys() and all(np.isclose(turned[k], scores[k], atol=1e-9) for k in scores)
    require(close, "scores do not depend on the order of clips")
    if cls.needs_pool:
        raises(UsageError, lambda: metric.summarise(table), "a metric that needs a pool requires it")
    raises(Undefined, lambda: metric.summarise(table[:0], table), "a set without clips is Undefined")


def _measured(metric: Metric, dance: Dance) -> npt.NDArray[np.float64] | None:
    """Return the numbers of a dance, or None where they are undefined."""
    try:
        row = metric.measure(dance)
    except Undefined as outcome:
        require(outcome.reason in OUTCOMES, f"outcomes are one of {', '.join(OUTCOMES)}")
        return None
    require(row.shape == (len(metric.columns),), f"measure gives ({len(metric.columns)},), not {row.shape}")
    require(row.dtype == np.float64, f"measure gives float64, not {row.dtype}")
    require(bool(np.isfinite(row).all()), "numbers are finite; without a value, measure raises Undefined")
    require(np.array_equal(metric.measure(dance), row), "equal dances give equal numbers")
    return row


def require(condition: bool, expected: str) -> None:
    """Raise AssertionError with what was expected, if it is not so."""
    if not condition:
        raise AssertionError(f"expected: {expected}")


def raises(kind: type[Exception], call: Callable[[], object], expected: str) -> str:
    """Return the text of the error that a call ends with; AssertionError if it ends without one of that kind."""
    try:
        call()
    except kind as error:
        return str(error)
    raise AssertionError(f"expected: {expected}")


def check_plugin(cls: type[Any]) -> None:
    """Check what all plug-ins share: a frozen dataclass whose fields are documented keys of a recipe."""
    require(dataclasses.is_dataclass(cls), f"{cls.__name__} is a dataclass")
    require(bool(cls.__dataclass_params__.frozen), f"{cls.__name__} is frozen")
    require(type(cls.version) is int and cls.version > 0, "version is a whole number above 0")
    text = inspect.getdoc(cls) or ""
    require(bool(text) and not text.startswith(f"{cls.__name__}("), f"{cls.__name__} has a docstring")
    described = "\n".join(inspect.getdoc(base) or "" for base in cls.__mro__)  # a base may add fields
    for field in dataclasses.fields(cls):
        require(re.search(rf"^{field.name}\b", described, re.M) is not None, f"the docstring describes {field.name}")
    from dancedata.files.documents import document_of
    from dancedata.recipes.plugins import make_plugin, single_plugin

    problems: list[str] = []
    registry = registry_of(cls)
    plugin = make_plugin(registry, "plugin", cls.name, {}, problems)
    require(not problems, f"the defaults are valid parameters: {problems}")
    document = document_of(plugin)
    again = single_plugin(registry, "plugin", json.loads(json.dumps({cls.name: document})), problems)
    require(not problems, f"what a dataset says of its recipe can be read again: {problems}")
    require(again == plugin and document_of(again) == document, "parameters survive the way through JSON")
    make_plugin(registry, "plugin", cls.name, {"no_such_key": 1}, problems)
    require(any("no_such_key" in p for p in problems), "a key that no field has is an error")


def registry_of(cls: type[Any]) -> Registry[Any]:
    """Return the registry that a plug-in is in; AssertionError if it is in none."""
    for registry in (*REGISTRIES.values(), EXPORTS):
        if cls in (registry.get(name) for name in registry.names()):
            return registry
    raise AssertionError(f"expected: {cls.__name__} is registered")

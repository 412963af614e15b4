"""Every registered plug-in keeps its kind's contract. No plug-in is named here: registries say which there are."""

import inspect
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.audio.bailando438 import Bailando438
from dancedata.core.clip import Reject
from dancedata.core.columns import Columns, Mirror, Spatial
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Augmentation, CopyAugmentation, SampleAugmentation
from dancedata.core.registry import (
    AUGMENTATIONS,
    CONTACTS,
    DATASETS,
    FEATURES,
    FILTERS,
    REGISTRIES,
    REPRESENTATIONS,
    RULES,
    Registry,
)
from dancedata.exports.base.job import EXPORTS
from dancedata.testing import conformance
from tests.features import bailando438_rows
from tests.messages import raises_message

KINDS = [*REGISTRIES.values(), EXPORTS]
PLUGINS = [registry.get(name) for registry in KINDS for name in registry.names()]


@pytest.mark.parametrize("plugin", PLUGINS, ids=lambda cls: f"{conformance.registry_of(cls).kind}-{cls.name}")
def test_plugin(plugin: type[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if conformance.registry_of(plugin) is EXPORTS:
        # Exports compute its columns for each slice and each rate; tests/audio has the columns.
        monkeypatch.setattr(Bailando438, "extract", bailando438_rows)
    conformance.check(plugin, tmp_path)


# The suite itself: a plug-in with one thing wrong does not pass.


def _first(registry: Registry) -> type[Any]:
    """The first plug-in of a kind; of representations the first that decodes."""
    classes = [registry.get(name) for name in registry.names() if name != "broken"]
    return next(cls for cls in classes if registry is not REPRESENTATIONS or cls.decodes)


def _register(monkeypatch: pytest.MonkeyPatch, registry: Registry, cls: type[Any]) -> type[Any]:
    """Register a class for the length of a test."""
    cls.name = "broken"
    monkeypatch.setitem(registry._classes, "broken", cls)
    return cls


def _subclass(registry: Registry, **members: Any) -> type[Any]:
    """The first plug-in of a kind with some members replaced."""
    base = _first(registry)
    return dataclass(frozen=True)(type("Broken", (base,), {"__doc__": base.__doc__, **members}))


def by_the_last_row(self: Any, seen: Any, dancer: int, starts: Any) -> Any:
    return [Reject("filtered", window=len(seen.rows("edge151", dancer)), detail="too late")]


def looks_at_the_place(self: Any, joints: Any, grid: Any, skeleton: Any) -> Any:
    return (joints[:, list(skeleton.feet), 0] > 1).astype(np.float32)


def without_a_mirror(self: Any) -> Columns:
    right = _first(REPRESENTATIONS)().columns
    return replace(right, mirror=Mirror(tuple(range(right.width)), (1,) * right.width))


def one_row_more(self: Any, n_samples: int, sample_rate: int, grid: Any) -> int:
    return _first(FEATURES).n_rows(self, n_samples, sample_rate, grid) + 1


def backwards(self: Any, source: Path) -> Any:
    found = _first(DATASETS).scan(self, source)
    return replace(found, clips=found.clips[::-1])


def by_a_group(self: Any, rows: Any, columns: Columns, grid: Any) -> Any:
    return rows[:, columns.slice("contact")].min() or None


WHEN = f"{inspect.getdoc(_first(CONTACTS))}\n\nwhen\n    A pair, which JSON makes a list.\n"


@pytest.mark.parametrize(
    ("registry", "members", "expected"),
    [
        (CONTACTS, {"__annotations__": {"secret": int}, "secret": 3}, "docstring describes secret"),
        (CONTACTS, {"__doc__": WHEN, "__annotations__": {"when": Any}, "when": (1, 2)}, "JSON"),
        (CONTACTS, {"__call__": looks_at_the_place}, "do not depend on x and z"),
        (REPRESENTATIONS, {"columns": property(without_a_mirror)}, "mirrored columns are the mirrored motion's"),
        (FEATURES, {"n_rows": one_row_more}, "as n_rows says"),
        (DATASETS, {"scan": backwards}, "sorted"),
        (FILTERS, {"reason": "ugly"}, "reason is one of"),
        (FILTERS, {"reject": by_a_group}, "group"),
        (RULES, {"judge": by_the_last_row}, "first frames"),
    ],
)
def test_a_plugin_with_one_thing_wrong_fails(monkeypatch, tmp_path, registry, members, expected):
    with pytest.raises((AssertionError, UsageError), match=expected):
        conformance.check(_register(monkeypatch, registry, _subclass(registry, **members)), tmp_path)


def test_a_class_that_is_not_frozen_fails(monkeypatch: pytest.MonkeyPatch):
    loose = dataclass(type("Loose", (), {"__doc__": "Something.", "version": 1}))
    with pytest.raises(AssertionError, match="frozen"):
        conformance.check_contact_rule(_register(monkeypatch, CONTACTS, loose))


def _augmentation(base: type[Any], **members: Any) -> type[Any]:
    """An augmentation with some members."""
    cls = type("Broken", (base,), {"__doc__": "Broken.", "version": 1, **members})
    return dataclass(frozen=True)(cls)


def test_an_augmentation_of_neither_kind_is_refused():
    with raises_message(UsageError, "choose_start", where="abc.Broken"):
        _augmentation(Augmentation, change_rows=lambda self, rows, columns, **about: rows)


def a_frame_later(self: Any, start: int, starts: Any, stride: int, draw: Any) -> int:
    return start + 1


@pytest.mark.parametrize(("base", "members", "expected"), [
    (CopyAugmentation, {"changes": "rows", "change_motion": lambda self, motion, clip: replace(motion)}, "declared"),
    (CopyAugmentation, {"changes": "music"}, "changes is rows, motion or time"),
    (SampleAugmentation, {"change_sample": lambda self, rows, field, draw: rows[:, :1]}, "dtype are kept"),
    (SampleAugmentation, {"change_sample": lambda self, rows, field, draw: rows * np.nan}, "samples are finite"),
    (SampleAugmentation, {"change_sample": lambda self, rows, field, draw: rows + np.float32(draw.uniform()),
                          "scaler_bounds": lambda self, low, high, field: (low, high + 0.01)}, "bounds` holds"),
    (SampleAugmentation, {"choose_start": a_frame_later}, "chooses_windows"),
    (SampleAugmentation, {"choose_start": a_frame_later, "chooses_windows": True}, "returns one of starts"),
    (SampleAugmentation, {"dropped": lambda self, fields, draw: ("music",)}, "dropped names some of them"),
])  # fmt: skip
def test_augmentations_that_are_not_as_declared_fail(monkeypatch, tmp_path, base, members, expected):
    cls = _register(monkeypatch, AUGMENTATIONS, _augmentation(base, **members))
    with pytest.raises(AssertionError, match=expected):
        conformance.check_augmentation(cls, tmp_path)


def test_copies_that_differ_from_call_to_call_fail(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    def change_rows(self: Any, rows: Any, columns: Any, **about: Any) -> Any:
        return rows + np.float32(len(calls.append(rows) or calls))

    calls: list[Any] = []
    cls = _augmentation(CopyAugmentation, change_rows=change_rows)
    with pytest.raises(AssertionError, match="equal rows give equal copies"):
        conformance.check_augmentation(_register(monkeypatch, AUGMENTATIONS, cls), tmp_path)


def test_a_representation_that_turns_wrongly_fails(monkeypatch: pytest.MonkeyPatch):
    base = REPRESENTATIONS.get("edge151")
    cls = dataclass(frozen=True)(
        type("Broken", (base,), {"__doc__": base.__doc__, "spatial": Spatial("y", base.spatial.roles)})
    )
    with pytest.raises(AssertionError, match="turns columns as `encode` turns"):
        conformance.check_representation(_register(monkeypatch, REPRESENTATIONS, cls))

"""Small random stores."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from dancedata.store.schema import Field
from dancedata.testing.stores import RandomStore, random_columns

MakeStore = Callable[..., RandomStore]


@pytest.fixture
def make_store(tmp_path: Path, random_store: MakeStore) -> MakeStore:
    """Return a function that makes small random stores, each in a separate folder."""
    count = 0

    def make(**options: Any) -> RandomStore:
        nonlocal count
        count += 1
        options.setdefault("fields", mixed_fields())
        return random_store(tmp_path / f"store{count}", **options)

    return make


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """An empty folder."""
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


def mixed_fields() -> tuple[Field, ...]:
    """Return two motion fields, one of them at 60 a second, and two audio fields, one of them float16."""
    return (
        Field("pose", "motion", random_columns(7), Fraction(30)),
        Field("fast", "motion", random_columns(4), Fraction(60)),
        Field("music", "audio", random_columns(5, mirror=False), Fraction(30)),
        Field("layer", "audio", random_columns(3, mirror=False), Fraction(30), "float16"),
    )

"""Builds of this room's tests go through building."""

from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True, scope="module")
def _through_building() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DANCEDATA_BUILDING", "1")
        yield

"""Stores that the readers' tests read."""

from __future__ import annotations

from pathlib import Path

import pytest

from dancedata.testing.stores import write_random_store


@pytest.fixture(scope="session")
def store_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of track scope: 22 x 141 = 3,102 train windows of 150 frames, in several shards."""
    out = tmp_path_factory.mktemp("readers") / "store"
    clips = {"train": 22, "val": 2, "test": 2}
    write_random_store(out, clips=clips, n_frames=(290, 290), length=150, stride=1)
    return out

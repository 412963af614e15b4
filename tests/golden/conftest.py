"""Reference output of programs for groups, and their inputs."""

from pathlib import Path

import numpy as np
import pytest

Arrays = dict[str, np.ndarray]


def load(path: Path) -> Arrays:
    with np.load(path) as file:
        return dict(file)


@pytest.fixture(scope="session")
def crowd(shared: Path) -> Path:
    return shared / "golden" / "crowd"

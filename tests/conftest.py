"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

from dancedata.pipeline import arithmetic

# Machines that run tests are busy: how long an example takes says nothing.
settings.register_profile("dancedata", deadline=None)
settings.load_profile("dancedata")

ROOT = Path(__file__).resolve().parent.parent

# Tests compute as the command line does, in their own process, where they can replace functions. With this variable
# they keep the kernels that the processor or OPENBLAS_CORETYPE chooses: tests of numbers have to pass on all of them.
if not os.environ.get("DANCEDATA_TEST_NATIVE"):
    arithmetic.adopt()


@pytest.fixture(scope="session")
def shared() -> Path:
    """Reference outputs and real clips, which are not part of the project; tests that need them skip without."""
    folder = Path(os.environ.get("DANCEDATA_SHARED", ROOT.parent / "shared"))
    if not (folder / "golden").is_dir():
        pytest.skip(f"reference outputs and real clips are not here ({folder}); set DANCEDATA_SHARED")
    return folder

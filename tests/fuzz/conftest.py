"""The harness, which runs its cases in child processes."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def hunt() -> ModuleType:
    """hunt.py, which is a script as well."""
    spec = importlib.util.spec_from_file_location(
        "fuzz_hunt", Path(__file__).parents[2] / "benchmarks" / "fuzz" / "hunt.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

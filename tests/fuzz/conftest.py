"""The programs of benchmarks/fuzz, which are scripts as well."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

TOOLS = Path(__file__).resolve().parents[2] / "benchmarks" / "fuzz"


def tool(name: str) -> ModuleType:
    """Import a script of the folder, whose imports are in the folder too."""
    sys.path.insert(0, str(TOOLS))
    try:
        spec = importlib.util.spec_from_file_location(f"fuzz_{name}", TOOLS / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(TOOLS))
    return module


@pytest.fixture(scope="session")
def hunt() -> ModuleType:
    """The harness, which runs its cases in child processes."""
    return tool("hunt")


@pytest.fixture(scope="session")
def hostile() -> ModuleType:
    """Files made to hurt."""
    return tool("hostile")

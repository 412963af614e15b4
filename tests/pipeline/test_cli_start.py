"""Starting is light: what is imported, not how long it takes."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: Each of these takes a good part of a second, or needs an extra.
HEAVY = {"torch", "librosa", "scipy", "numba", "sklearn", "pandas", "matplotlib", "soundfile", "soxr"}
#: And these a command needs only once it runs.
LATER = HEAVY | {"h5py", "joblib", "yaml", "tqdm", "numpy"}


def imported(*args: str) -> set[str]:
    """Top-level packages that a fresh interpreter imports."""
    result = subprocess.run([sys.executable, "-X", "importtime", *args], check=True, capture_output=True, text=True)
    lines = [line for line in result.stderr.splitlines() if line.startswith("import time:")]
    names = {line.rsplit("|", 1)[1].strip().split(".")[0] for line in lines}
    assert "dancedata" in names
    return names


def test_importing_the_package_is_light():
    assert imported("-c", "import dancedata") & (LATER | {"pydantic", "typer"}) == set()


@pytest.mark.parametrize("args", [["--help"], ["build", "--help"], ["--version"]])
def test_help_is_light(args: list[str]):
    # Not pydantic: some versions of typer need it to read their arguments.
    assert imported("-m", "dancedata", *args) & LATER == set()


def test_reading_is_light():
    names = imported("-c", "import dancedata; dancedata.open")
    assert names & (HEAVY | {"joblib", "pydantic", "typer"}) == set()

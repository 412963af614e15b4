"""A dataset that is not written again is opened and verified, and gives the numbers that were read when it was."""

import json
import tarfile
from pathlib import Path
from typing import Any

import pytest

import dancedata
from tests.frozen.freeze import read

ARCHIVES = sorted(Path(__file__).parent.glob("*.tar.xz"))


@pytest.fixture(params=ARCHIVES, ids=lambda path: path.name)
def frozen(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """The dataset of an archive, and what was read from it then."""
    with tarfile.open(request.param) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # Python 3.11 has it from 3.11.4 on
        archive.extractall(tmp_path)
    [(name, then)] = json.loads((tmp_path / "read.json").read_text()).items()
    return tmp_path / name, then


def test_the_numbers_are_those_of_then(frozen: tuple[Path, dict[str, Any]]) -> None:
    folder, then = frozen
    now = read(folder)
    normalized = then.pop("normalized")
    if "normalized" in now:  # with torch
        assert now.pop("normalized") == pytest.approx(normalized, abs=1e-6)  # rounded when they were frozen
    assert now == then
    assert [p.message for p in dancedata.check(folder, progress=False) if p.severity == "error"] == []

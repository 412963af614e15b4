"""Datasets of earlier versions are opened and verified, and give the numbers that their own version read."""

import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from tests.frozen.freeze import read

FOLDER = Path(__file__).parent
ARCHIVES = sorted(path.name for path in FOLDER.glob("*.tar.xz"))


@pytest.fixture
def frozen(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """The dataset of an archive, and what was read from it then."""
    with tarfile.open(FOLDER / request.param) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # Python 3.11 has it from 3.11.4 on
        archive.extractall(tmp_path)
    [(name, then)] = json.loads((tmp_path / "read.json").read_text()).items()
    return tmp_path / name, then


def test_both_formats_are_frozen() -> None:
    assert {"3f9a569a.tar.xz", "2b30159c.tar.xz", "bb82729a.tar.xz", "520318d1.tar.xz"} <= set(ARCHIVES)
    assert sum((FOLDER / name).stat().st_size for name in ARCHIVES) < 50_000 * len(ARCHIVES)


@pytest.mark.parametrize("frozen", ARCHIVES, indirect=True)
def test_the_numbers_are_those_of_its_version(frozen: tuple[Path, dict[str, Any]]) -> None:
    folder, then = frozen
    now = read(folder)
    normalized = then.pop("normalized")
    if "normalized" in now:  # with torch
        assert now.pop("normalized") == pytest.approx(normalized, abs=1e-6)  # rounded when they were frozen
    assert now == then


@pytest.mark.parametrize("frozen", ARCHIVES, indirect=True)
def test_it_is_sound(frozen: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = frozen
    assert [p.message for p in dancedata.check(folder, progress=False) if p.severity == "error"] == []


@pytest.mark.parametrize("frozen", ["3f9a569a.tar.xz", "2b30159c.tar.xz", "bb82729a.tar.xz"], indirect=True)
def test_its_motion_decodes(frozen: tuple[Path, dict[str, Any]]) -> None:
    ds = dancedata.open(frozen[0])
    rows = ds.read(ds.windows("train")[0], "edge151")
    motion = dancedata.decode(rows, "edge151")
    np.testing.assert_allclose(motion.translation[:, [0, 2, 1]] * (1, -1, 1), rows[:, 4:7], atol=1e-6)

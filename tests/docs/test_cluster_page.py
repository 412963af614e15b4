"""The commands of docs/guides/beyond-one-machine.md build the same bytes; clusters are in tests/fault."""

import os
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests import warm
from tests.docs.pages import text_of

SECTION = text_of("docs/guides/beyond-one-machine.md").split("## The same build everywhere")[1].split("\n## ")[0]


BUILDS = re.findall(r"^dancedata build .*", SECTION, flags=re.MULTILINE)


def run(line: str, corpus: Path, out: Path, environment: Mapping[str, str], number: str = "") -> Path:
    """Run a command of the page with the names of this machine; returns OUT."""
    names = {
        "/scratch/finedance": str(corpus), "/scratch/data/finedance": str(out), "build finedance": "build aist++",
        "--jobs 8": "--jobs 2", "$SLURM_ARRAY_TASK_ID/16": f"{number}/2",
    }  # fmt: skip
    for name, here in names.items():
        assert line.count(name) <= 1
        line = line.replace(name, here)
    done = warm.run(["python", "-m", *line.split()], environment)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Return an environment with a separate cache."""
    return {**os.environ, "DANCEDATA_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(Path.cwd())}


def test_the_page_has_every_way() -> None:
    assert len(re.findall(r"^```sh$", SECTION, flags=re.MULTILINE)) == 5
    clusters = [re.findall(r"--cluster (\w+)", line) for line in BUILDS]
    assert sorted(clusters) == [[], [], [], ["ray"], ["tcp"]]


def test_one_machine_and_an_array_build_the_same(corpus, built, tmp_path, environment, hashes):
    alone, part, collect = (line for line in BUILDS if "--cluster" not in line)
    assert hashes(run(alone, corpus, tmp_path / "alone", environment)) == hashes(built)
    environment["DANCEDATA_CACHE"] = str(tmp_path / "shared")
    assert "--array=1-16" in SECTION
    for number in "12":
        run(part, corpus, tmp_path / "no", environment, number)
    assert not (tmp_path / "no").exists()
    assert hashes(run(collect, corpus, tmp_path / "array", environment)) == hashes(built)

"""The commands of docs/guides/beyond-one-machine.md build the same bytes, as far as one machine goes.

python -m pytest -m nightly tests/docs/test_cluster_page.py      Dask, Ray and Spark, two workers each
"""

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests import warm
from tests.clusters import dask_cluster, ray_cluster
from tests.docs.pages import text_of

SECTION = text_of("docs/guides/beyond-one-machine.md").split("## The same build everywhere")[1].split("\n## ")[0]
MODULES = {"tcp": "distributed", "ray": "ray"}


def commands(scheduler: str = "") -> list[str]:
    """Return the builds of the section that have this kind of scheduler; "": none."""
    lines = re.findall(r"^dancedata build .*", SECTION, flags=re.MULTILINE)
    return [line for line in lines if re.findall(r"--cluster (\w+)", line) == ([scheduler] if scheduler else [])]


def run(line: str, corpus: Path, out: Path, environment: Mapping[str, str], **names: str) -> Path:
    """Run a command of the page with the names of this machine; returns OUT."""
    names |= {
        "/scratch/finedance": str(corpus), "/scratch/data/finedance": str(out), "build finedance": "build aist++",
        "--jobs 8": "--jobs 2",
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
    assert [len(commands(kind)) for kind in ("", *MODULES)] == [3, 1, 1]


def test_one_machine_and_an_array_build_the_same(corpus, built, tmp_path, environment, hashes):
    alone, part, collect = commands()
    assert hashes(run(alone, corpus, tmp_path / "alone", environment)) == hashes(built)
    environment["DANCEDATA_CACHE"] = str(tmp_path / "shared")
    assert "--array=1-16" in SECTION
    for number in "12":
        run(part, corpus, tmp_path / "no", environment, **{"$SLURM_ARRAY_TASK_ID/16": f"{number}/2"})
    assert not (tmp_path / "no").exists()
    assert hashes(run(collect, corpus, tmp_path / "array", environment)) == hashes(built)


@contextmanager
def cluster(kind: str, environment: dict[str, str]) -> Iterator[dict[str, str]]:
    """Run a cluster; gives what takes the place of names of the page."""
    if kind == "tcp":
        with dask_cluster(environment) as address:
            yield {"tcp://HOST:8786": address}
    else:
        with ray_cluster(environment):
            yield {}


@pytest.mark.nightly
@pytest.mark.parametrize("kind", MODULES)
def test_a_cluster_builds_the_same(corpus, built, tmp_path, environment, hashes, kind):
    if not find_spec(MODULES[kind]):
        pytest.skip(f"{MODULES[kind]} is not installed")
    (line,) = commands(kind)
    with cluster(kind, environment) as names:
        assert hashes(run(line, corpus, tmp_path / "out", environment, **names)) == hashes(built)

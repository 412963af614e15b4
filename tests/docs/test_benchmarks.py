"""Every script of benchmarks/ runs to its end, with its smallest size: python -m pytest -m nightly FILE."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs.pages import ROOT, load

#: Arguments of each script. {corpus} is a source of AIST++; its dataset is {built}, a file of it {bvh}.
SMALLEST = {
    "align": "--clips 2", "face": "", "build": "40 --jobs 1", "drawing": "{built} --rounds 1 --seconds 0.5",
    "encoders": "--minutes 0.1", "features": "--songs 2 --plain-windows 1", "groups": "--clips 40 --rounds 1",
    "intervals": "--sets 10", "jukebox": "", "kinematics": "--quick", "lines": "HEAD",
    "metric_switches": "{corpus} --song {corpus}/wavs/mHO3.wav", "metrics": "--clips 1",
    "million": "--clips 100 --processes 1", "pages": "--clips 3", "quality": "--planted 1 --clips 2",
    "ratios": "{root} {root} ratios demo --rounds 1", "reading": "--quick --rounds 1 --wide 0",
    "remote": "--quick --rounds 1 --shards 1", "retarget": "{bvh}", "rings": "--pairs", "scaling": "units",
    "sounds": "", "startup": "--rounds 1", "tables": "{root} {root} --clips 100 --rounds 1", "up_axis": "cuts",
    "values": "{root} {root} values demo", "walk": "", "writing": "aist++ {corpus} cache writing",
}  # fmt: skip
#: Modules of others; what writes a page here, which is read below; what reads checkouts of other projects.
NOT_RUN = {"metric_loops", "reading_peers", "history", "splits", "value_cases", "ensemble", "tables"}


def test_no_script_hides_a_package_from_what_it_imports() -> None:
    names = {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
    assert names == SMALLEST.keys() | NOT_RUN
    code = f"import importlib.util as i; print([n for n in {sorted(names)} if i.find_spec(n)])"
    assert subprocess.check_output([sys.executable, "-P", "-c", code], cwd=ROOT, env={}, text=True) == "[]\n"


@pytest.mark.nightly
@pytest.mark.parametrize("name", SMALLEST)
def test_a_benchmark_runs(name: str, corpus: Path, built_in: dict[str, Path], tmp_path: Path) -> None:
    if name == "drawing" and not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.skip("no chromium")
    built, bvh = built_in["track"], tmp_path / "bvh"
    if name == "retarget":
        command = ["-m", "dancedata", "export", built, "--to", "bvh", "--out", bvh]
        subprocess.run([sys.executable, *map(str, command)], check=True, cwd=ROOT)
        bvh = sorted(bvh.rglob("*.bvh"))[0]
    words = SMALLEST[name].format(corpus=corpus, built=built, bvh=bvh, root=ROOT).split()
    folder = ROOT if name == "lines" else tmp_path
    command = [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *words]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}  # scripts import each other
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]


# The measurements as data and as a page.


FOLDER = ROOT / "benchmarks"
PAGE = (FOLDER / "history.md").read_text(encoding="utf-8")
DATA = json.loads((FOLDER / "history.json").read_text(encoding="utf-8"))


@pytest.fixture
def history() -> ModuleType:
    return load(FOLDER / "history.py")


def test_the_page_and_the_data_are_equal(history: ModuleType) -> None:
    hint = "run python benchmarks/history.py, or with --from-page after a change of the page"
    assert history.page_of(DATA) == PAGE, hint
    assert history.read_page(PAGE) == DATA, hint

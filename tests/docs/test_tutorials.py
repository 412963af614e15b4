"""The tutorials, in one folder and one session, as their reader goes through them."""

import contextlib
import importlib
import io
import json
import os
import re
import shlex
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from typer.testing import CliRunner

from dancedata.cli.app import app
from tests import warm
from tests.docs.pages import ROOT

PAGES = ("captures", "aistpp-to-a-table", "add-your-own")
#: What this test trains and samples less; the notebooks, at night, run as they are.
SHORTER = {
    "range(10)": "range(1)", "steps=10": "steps=2",
    "DataLoader(test, 32)": "DataLoader(torch.utils.data.Subset(test, range(0, len(test), 6)), 32)",
}  # fmt: skip
_BLOCK = re.compile(r"(<!-- not run[^>]*-->\n)?^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page: str) -> Iterator[tuple[str, str]]:
    """Return language and text of the blocks that a reader runs, or compares."""
    text = (ROOT / "docs" / "tutorials" / f"{page}.md").read_text(encoding="utf-8")
    for skipped, language, code in _BLOCK.findall(text):
        if not skipped:
            yield language, code


@pytest.fixture
def environment(tmp_path: Path, cache: Path) -> dict[str, str]:
    """The environment of a reader: `dancedata` and `python` are those of this run."""
    tools = tmp_path / "tools"
    tools.mkdir()
    for name, more in (("dancedata", " -m dancedata"), ("python", "")):
        tool = tools / name
        tool.write_text(f'#!/bin/sh\nexec "{sys.executable}"{more} "$@"\n')
        tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    return {
        **os.environ,
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "DANCEDATA_CACHE": str(cache),
    }


@pytest.fixture
def one_thread() -> Iterator[None]:
    """torch on one thread: threads of several tests on one machine wait for each other at each step."""
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def run(line: str, environment: dict[str, str], *, here: bool) -> None:
    """Run a line of a shell block; commands of dancedata in this process if `here`, or a fork: it saves imports.

    Builds have one job: results are equal, and workers would import all of it again.
    """
    command, _, target = line.partition(" > ")
    name, *words = shlex.split(command)
    if words[0] in ("build", "align"):
        words += ["--jobs", "1"]
    if name == "dancedata" and here and not target:
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, f"{line}\n{done.output}\n{done.exception}"
    elif name in ("dancedata", "python"):
        code = ["-m", name, *words]
        if words[0] == "-m":
            code = ["-c", f"import runpy; runpy.run_module({words[1]!r}, run_name='__main__')", *words[2:]]
        elif name == "python":
            code = ["-c", Path(words[0]).read_text("utf-8"), *words[1:]]
        forked = warm.run([sys.executable, *code], environment)
        assert forked.returncode == 0, f"{line}\n{forked.stdout}\n{forked.stderr}"
        if target:
            Path(target).write_text(forked.stdout, encoding="utf-8")
    else:
        command = ["bash", "-e", "-c", line]
        process = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert process.returncode == 0, f"{line}\n{process.stdout}\n{process.stderr}"


@pytest.mark.usefixtures("one_thread", "no_local_plugins")
@pytest.mark.filterwarnings("ignore")  # Lightning's advice on loaders and loggers
def test_the_tutorials_run_and_print_the_output_shown(environment, tmp_path, monkeypatch):
    folder = tmp_path / "desk"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("DANCEDATA_CACHE", environment["DANCEDATA_CACHE"])
    names: dict[str, object] = {}
    shortened = 0
    for page in PAGES:
        printed = ""
        for language, code in blocks(page):
            if language == "sh":
                for line in code.replace("CHECKOUT", str(ROOT)).splitlines():
                    run(line, environment, here=page != "add-your-own")  # a plug-in would stay in this process
            elif language == "python":
                for long, short in SHORTER.items():
                    shortened += code.count(long)
                    code = code.replace(long, short)
                with contextlib.redirect_stdout(io.StringIO()) as out:
                    exec(compile(code, f"{page}.md", "exec"), names)
                printed = out.getvalue()
            elif language == "yaml":
                Path("mine.yaml").write_text(code, encoding="utf-8")
            elif language == "text":
                shown = printed or Path("captures/manifest.csv").read_text(encoding="utf-8")
                assert code in shown or code.strip() in shown, f"{page}: {code}\nprinted {printed}"
    assert shortened == len(SHORTER)
    wall = (folder / "wall.html").read_text(encoding="utf-8")
    assert any(f"{path.stem} gen" in wall for path in Path("gen").iterdir())  # a dancer beside the truth
    assert (folder / "gen.html").exists()
    assert len(list((folder / "bvh").iterdir())) == len(list((folder / "gen").glob("*.npz"))) > 10


# The tutorials as notebooks: all that a reader runs is in them, and equal pages give equal bytes.


@pytest.fixture
def notebooks(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    monkeypatch.delitem(sys.modules, "notebooks", raising=False)
    return importlib.import_module("notebooks")


def test_they_hold_what_a_reader_runs(notebooks: ModuleType, tmp_path: Path) -> None:
    one, two = (notebooks.write(ROOT, tmp_path / name) for name in ("one", "two"))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in two]
    assert [path.stem for path in one] == list(PAGES)
    for page, path in zip(PAGES, one, strict=True):
        book = json.loads(path.read_text(encoding="utf-8"))
        code = ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]
        magic = {"sh": "%%bash\n", "python": "", "yaml": "%%writefile mine.yaml\n"}
        assert code == [magic[kind] + text.strip("\n") for kind, text in blocks(page) if kind in magic]
        assert len({cell["id"] for cell in book["cells"]}) == len(book["cells"])
        assert book["cells"][0]["source"][0].startswith("# ")


@pytest.mark.nightly
def test_they_are_valid_and_run(notebooks, environment, tmp_path, monkeypatch):
    """Run with ``pytest -m nightly tests/docs/test_tutorials.py``, where nbclient and ipykernel are installed."""
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    for name in ("PATH", "PYTHONPATH", "DANCEDATA_CACHE"):
        monkeypatch.setenv(name, environment[name])
    desk = tmp_path / "desk"
    desk.mkdir()
    for path in notebooks.write(ROOT, tmp_path / "notebooks"):
        book = nbformat.reads(path.read_text(encoding="utf-8").replace("CHECKOUT", str(ROOT)), as_version=4)
        nbformat.validate(book)
        nbclient.NotebookClient(book, timeout=600, resources={"metadata": {"path": str(desk)}}).execute()
    assert (desk / "wall.html").exists()

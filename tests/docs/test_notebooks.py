"""The tutorials as notebooks: all that a reader runs is in them, and equal pages give equal bytes."""

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs.pages import ROOT
from tests.docs.test_tutorials import PAGES, blocks, environment  # noqa: F401 (a fixture)


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
def test_they_are_valid_and_run(notebooks, environment, tmp_path, monkeypatch):  # noqa: F811
    """Run with ``pytest -m nightly tests/docs/test_notebooks.py``, where nbclient and ipykernel are installed."""
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

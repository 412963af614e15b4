"""The measurements as data and as a page."""

import json
import re
from types import ModuleType

import pytest

from tests.docs.pages import ROOT, load

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


def test_nothing_of_a_table_is_lost() -> None:
    tables = [block for section in DATA for block in section["blocks"] if "columns" in block]
    lines = [line for line in PAGE.splitlines() if line.startswith("|") and not line.startswith("|---")]
    assert sum(1 + len(table["rows"]) for table in tables) == len(lines)
    assert all(len(row) == len(table["columns"]) for table in tables for row in table["rows"])
    for script in {name for section in DATA for name in re.findall(r"benchmarks/\w+\.py", str(section["commands"]))}:
        assert (FOLDER.parent / script).is_file()


def test_what_a_section_states(history: ModuleType) -> None:
    first = next(section for section in DATA if section["title"] == "Audio features: librosa35")
    assert (first["dates"], first["versions"]["scipy"]) == (["2026-11-21"], "1.17.1")
    row = first["blocks"][2]["rows"][1]
    assert [history.numbers(cell) for cell in row[1:]] == [[5.2, 5.0], [33, 34], [30, 36]]
    assert history.numbers("1.2e-6 m of 19,345 windows") == [1.2e-6, 19345]

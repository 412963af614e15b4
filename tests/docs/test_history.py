"""The measurements as data and as a page."""

import json
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

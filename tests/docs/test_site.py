"""The site: navigation, reference, and what is checked of the HTML. `.ci/run` builds it."""

import ast
import importlib
import importlib.util
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.docs.pages import ROOT, WRITTEN, load
from tests.report.test_colours import contrast

SITE = ROOT / "docs" / "site"


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch):
    """Import one file of docs/site."""
    monkeypatch.syspath_prepend(str(SITE))

    def load(name: str) -> ModuleType:
        for own in ("hero", "navigation", "reference", "themed", "written"):
            monkeypatch.delitem(sys.modules, own, raising=False)
        return importlib.import_module(name)

    return load


def test_every_page_is_in_one_group_of_the_navigation(module) -> None:
    groups = module("navigation").groups(ROOT)
    found = [page for pages in groups.values() for _, page in pages]
    there = {str(path.relative_to(ROOT).with_suffix("")) for path in WRITTEN}
    assert there - {"docs/README"} == {page for page in found if page.startswith("docs/")}
    assert len(found) == len(set(found))
    assert "" not in groups  # a table above the first group


def test_modules_that_pages_import_are_in_the_reference(module) -> None:
    listed = set(module("reference").MODULES)
    assert all(importlib.util.find_spec(name) for name in listed)
    missing = set()
    for path in [ROOT / "README.md", *WRITTEN]:
        for block in re.findall(r"^```python\n(.*?)^```", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "dancedata":
                    missing |= {f"{path.name}: {node.module}"} if node.module not in listed else set()
    assert missing == set()


def test_foreign_pages_in_the_folder_of_the_reference_stay(module, tmp_path: Path) -> None:
    reference, folder = module("reference"), tmp_path / "docs" / "api"
    folder.mkdir(parents=True)
    (folder / "notes.rst").write_text("notes\n=====\n\nmine\n")
    (folder / "dancedata.core.grid.rst").write_text(reference.page("dancedata.core.grid", []))
    reference.write_pages(tmp_path, ["dancedata.cache"])
    assert sorted(path.name for path in folder.iterdir()) == ["dancedata.cache.rst", "index.rst", "notes.rst"]


def test_dead_links_and_what_other_hosts_serve_are_found(module, tmp_path: Path) -> None:
    findings = {
        '<a href="b.html#here">': None,
        '<a href="https://example.org/x">': None,
        '<a href="b.html#there">': "a.html: no such anchor: b.html#there",
        '<a href="#own">': "a.html: no such anchor: #own",
        '<img src="gone.svg">': "a.html: no such file: gone.svg",
        '<script src="https://example.org/x.js"></script>': "a.html: loads https://example.org/x.js",
        '<link rel="stylesheet" href="//example.org/x.css">': "a.html: loads //example.org/x.css",
    }
    (tmp_path / "a.css").write_text('@import "https://example.org/font.css"; a {background: url(own.png)}')
    (tmp_path / "b.html").write_text('<h2 id="here">')
    for html, finding in findings.items():
        (tmp_path / "a.html").write_text(html)
        css = "a.css: loads https://example.org/font.css"
        assert sorted(module("written").findings(tmp_path)) == sorted([css, *([finding] if finding else [])])


def test_a_dancer_moves_on_the_first_screen(module) -> None:
    hero = module("hero")
    text = [(ROOT / "README.md").read_text(encoding="utf-8")]
    hero.add("README", text)
    start = text[0][: text[0].index("## Set up")]
    assert start.startswith("# dancedata\n")
    assert 'src="clip.html#play=1' in start
    assert all((ROOT / page).is_file() for page in re.findall(r"\]\((docs/tutorials/[^)]+)\)", start))
    assert "viewer.png" not in text[0]
    with pytest.raises(ValueError, match="no picture of the viewer"):
        hero.add("docs/guides/look", ["# A page without pictures\n"])


# The drawings: as docs/images/draw.py makes them, readable in both colour schemes, complete in themselves.


IMAGES = ROOT / "docs" / "images"
DRAWN = ("build", "slices", "layers")


@pytest.fixture(scope="module")
def draw() -> ModuleType:
    return load(IMAGES / "draw.py")


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_colours_are_readable(draw: ModuleType, scheme: int) -> None:
    colours = {name: both[scheme] for name, both in draw.COLOURS.items()}
    for text in ("text", "muted"):
        assert min(contrast(colours[text], colours[ground]) for ground in ("ground", "box")) >= 4.5
    for graphic in ("line", "track", "window"):
        assert contrast(colours[graphic], colours["ground"]) >= 3


def _numbers(text: str) -> np.ndarray:
    return np.array(re.findall(r"-?\d+\.?\d*", text), float)


@pytest.mark.parametrize("name", DRAWN)
def test_the_files_are_those_that_the_script_draws(draw: ModuleType, name: str) -> None:
    stored = (IMAGES / f"{name}.svg").read_text(encoding="utf-8")
    drawn = getattr(draw, f"{name}_picture")()
    assert re.sub(r"-?\d+\.?\d*", "0", stored) == re.sub(r"-?\d+\.?\d*", "0", drawn)
    np.testing.assert_allclose(_numbers(stored), _numbers(drawn), atol=0.11)  # a tenth of a pixel is rounding


@pytest.mark.parametrize("path", sorted(IMAGES.glob("*.svg")), ids=lambda path: path.name)
def test_pictures_are_complete_in_themselves(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    root = ET.fromstring(text)
    assert root.find("{http://www.w3.org/2000/svg}title") is not None
    assert len(re.findall(r"https?://", text)) == text.count("http://www.w3.org/")
    assert "<script" not in text


PAGES = [ROOT / "README.md", *WRITTEN]


def test_photographs_are_small_and_each_is_taken_by_the_script() -> None:
    sizes = {path.stem: path.stat().st_size for path in IMAGES.glob("*.png")}
    script = (IMAGES / "shoot.py").read_text(encoding="utf-8")
    shown = script[script.index("SHOTS:") : script.index("_SIZES")]
    names = re.findall(r'^    "([a-z-]+)": ', shown, flags=re.MULTILINE)
    assert sizes.keys() == {name + theme for name in names for theme in ("", "-dark")}
    assert max(sizes.values()) <= 200_000
    assert sum(sizes.values()) < 1_500_000  # both themes


def test_every_picture_is_shown_and_credited() -> None:
    shown = {path: set(re.findall(r"images/([\w-]+\.(?:png|svg))\)", path.read_text("utf-8"))) for path in PAGES}
    there = {path.name for path in IMAGES.iterdir() if path.suffix in (".png", ".svg")}
    assert set().union(*shown.values()) == {name for name in there if not name.endswith("-dark.png")}
    for path, names in shown.items():
        if any(name.startswith("viewer") or name == "report-against.png" for name in names):
            text = path.read_text("utf-8")
            assert "(Li et al., ICCV 2021; Tsuchida" in text
            assert "https://creativecommons.org/licenses/by/4.0/" in text
        if any(name.startswith("viewer") for name in names):
            assert "Karissa" in text
            assert "https://creativecommons.org/licenses/by/3.0/" in " ".join(text.split())

"""The drawings: as docs/images/draw.py makes them, readable in both colour schemes, complete in themselves."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.docs.pages import ROOT, WRITTEN, load
from tests.report.test_colours import contrast

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

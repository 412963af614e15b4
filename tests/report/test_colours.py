"""Text has a contrast of 4.5 to 1 and graphics of 3 to 1 in both themes, computed from the style sheet."""

import re
from importlib.resources import files

import pytest

from dancedata.plot.dancers import SIDES
from dancedata.plot.timeline import THEMES

STYLE = files("dancedata.pages").joinpath("static", "report.css").read_text(encoding="utf-8")
BLOCKS = re.findall(r"color-scheme: (light|dark);\n(.*?)\}", STYLE, flags=re.DOTALL)


def luminance(colour: str) -> float:
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    red, green, blue = (p / 12.92 if p <= 0.03928 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(a: str, b: str) -> float:
    low, high = sorted((luminance(a), luminance(b)))
    return (high + 0.05) / (low + 0.05)


def colours(text: str) -> dict[str, str]:
    return dict(re.findall(r"--([\w]+): (#[0-9a-f]{6})", text))


def test_both_themes_exist_and_the_system_chooses() -> None:
    assert [theme for theme, _ in BLOCKS] == ["light", "dark", "dark"]
    assert colours(BLOCKS[1][1]) == colours(BLOCKS[2][1])
    assert colours(BLOCKS[0][1]).keys() == colours(BLOCKS[1][1]).keys()


@pytest.mark.parametrize("block", [0, 1])
def test_contrast(block: int) -> None:
    palette = colours(BLOCKS[block][1])
    assert luminance(palette["left"]) > luminance(palette["right"])
    assert contrast(palette["left"], palette["right"]) >= 1.6
    for ground in ("bg", "panel"):
        for name in ("ink", "dim", "link", "bad", "look"):
            assert contrast(palette[name], palette[ground]) >= 4.5, (name, ground)
        for name in ("s0", "s1", "s2", "s3", "s4", "s5", "left", "right", "mid", "other"):
            assert contrast(palette[name], palette[ground]) >= 3, (name, ground)


@pytest.mark.parametrize("theme", list(THEMES))
def test_contrast_of_videos(theme: str) -> None:
    palette = THEMES[theme]
    _, left, right = SIDES[theme]
    assert luminance(left) > luminance(right)
    assert contrast(left, right) >= 1.6  # two tones of grey in print
    for ground in ("bg", "panel"):
        for name in ("ink", "dim"):
            assert contrast(palette[name], palette[ground]) >= 4.5, (name, ground)
        for colour in (*SIDES[theme], palette["contact"], palette["path"], palette["wave"]):
            assert contrast(colour, palette[ground]) >= 3, (colour, ground)

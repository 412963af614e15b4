"""The page: one file that makes no request, runs nothing from a dataset, and can be read in both themes."""

import html
import json
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.scene.figure import Figure
from dancedata.scene.page import clip_page, page_parts, source_hash
from dancedata.scene.payload import page_json
from dancedata.scene.stills import middle_still
from dancedata.synthetic import synthesise_motion
from dancedata.viewer.notebook import MOST_CLIPS, html_of
from tests.report.test_colours import contrast
from tests.report.test_page import Page
from tests.scene.helpers import HOSTILE

MARKUP = '</script><img src=x onerror="window.PWN=1">\u2028\u202e&amp;'


@pytest.fixture(scope="module")
def page(scenes) -> str:
    return clip_page(scenes("thirty"), scenes("thirty").items[:2])


def test_it_is_one_file(page: str) -> None:
    read = Page(page)
    assert not [tag for tag, attrs in read.elements if tag in ("img", "iframe", "object", "embed") or "src" in attrs]
    assert [attrs.get("href") for tag, attrs in read.elements if tag == "link"] == ["data:,"]
    assert "://" not in page_parts().script + page_parts().html + page_parts().css
    assert len(page) < 400_000


def test_its_policy_allows_its_own_script_and_style_only(page: str) -> None:
    read = Page(page)
    policy = read.policy()
    assert "unsafe" not in policy
    assert policy.startswith("default-src 'none'")
    assert f"script-src '{source_hash(read.scripts[1][1])}'" in policy
    assert f"style-src '{source_hash(read.styles[0])}'" in policy
    inline = [a for _, a in read.elements for name in a if name == "style" or name.startswith("on")]
    assert not inline  # attributes that the policy would refuse


def test_names_are_data(scenes) -> None:
    dataset = scenes("thirty")
    item = dataset.items[0]
    clip = replace(item.clip, genre=MARKUP, music=MARKUP, dancer=MARKUP)
    page = clip_page(dataset, [replace(item, clip=clip)])
    read = Page(page)
    assert len(read.scripts) == 2
    assert "img" not in [tag for tag, _ in read.elements]
    data = json.loads(read.scripts[0][1])
    assert data["clips"]["0"]["genre"] == MARKUP
    assert page_json({"a": MARKUP}).isascii()
    assert "<" not in page_json({"a": MARKUP})


def test_a_clip_shows_itself(scenes) -> None:
    dataset = scenes("thirty")
    shown = html_of(dataset.store[dataset.items[0].id])
    ((tag, attrs),) = Page(shown).elements
    assert tag == "iframe"
    assert attrs["sandbox"] == "allow-scripts"
    data = json.loads(Page(attrs["srcdoc"]).scripts[0][1])
    assert data["single"]
    assert len(data["list"]["items"]) == 1
    assert html.unescape(html.escape(attrs["srcdoc"])) == attrs["srcdoc"]


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_script_is_javascript(tmp_path) -> None:
    script = tmp_path / "viewer.js"
    script.write_text(page_parts().script)
    done = subprocess.run(["node", "--check", str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def colours(theme: str) -> dict[str, str]:
    """Variables of a theme, from the style sheet."""
    blocks = re.findall(r':root(\[data-theme="light"\])? \{([^}]*)\}', page_parts().css)
    text = next(body for mark, body in blocks if bool(mark) == (theme == "light"))
    colour_of = dict(re.findall(r"--([a-z]+): (#[0-9a-f]{3,6})\b", text))
    return {name: "#" + "".join(2 * c for c in v[1:]) if len(v) == 4 else v for name, v in colour_of.items()}


def linear(colour: str) -> np.ndarray:
    """Linear RGB."""
    c = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab_deuteranopia(colour: str) -> np.ndarray:
    """CIE L*a*b* of a colour as seen without M cones (Machado et al. 2009, severity 1)."""
    seen = np.clip(
        np.array(
            [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
        ) @ linear(colour), 0, 1,
    )  # fmt: skip
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ seen
    f = np.cbrt(xyz / (0.9505, 1, 1.089))
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_contrasts(theme: str) -> None:
    palette = colours(theme)
    for text in ("ink", "dim", "flag"):
        assert min(contrast(palette[text], palette[ground]) for ground in ("bg", "panel", "sel")) >= 4.5, text
    assert contrast(palette["press"], palette["accent"]) >= 4.5
    for graphic in ("left", "right", "mid", "contact", "flag", "wave", "win", "accent", "other", "edge"):
        assert min(contrast(palette[graphic], palette[ground]) for ground in ("bg", "panel")) >= 3, graphic


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_colours_differ_without_m_cones(theme: str) -> None:
    palette = {name: lab_deuteranopia(value) for name, value in colours(theme).items()}
    for one, other in (("left", "right"), ("contact", "flag"), ("left", "mid"), ("right", "mid")):
        assert np.linalg.norm(palette[one] - palette[other]) > 14, (one, other)


def test_a_page_without_data_is_small() -> None:
    parts = page_parts()
    assert len((parts.css + parts.html + parts.script).encode()) < 135_000
    assert not re.search(r"^(?:[ \t]|//|\n)", parts.script, flags=re.MULTILINE)  # no layout of the source


def test_modules_share_no_name() -> None:
    """They become one script, in which a second function of a name would silently take the place of the first."""
    names: list[str] = []
    for path in files("dancedata.scene").joinpath("static", "js").iterdir():
        text = path.read_text(encoding="utf-8")
        names += re.findall(r"^(?:export )?(?:async )?(?:const|let|function|class) (\w+)", text, flags=re.MULTILINE)
    assert len(names) > 300
    assert [name for name, count in Counter(names).items() if count > 1] == []


# Tables of a notebook: datasets and lists of clips, names as text, a still of each clip.


def test_a_dataset_shows_its_numbers_and_first_clips(odd: Path) -> None:
    ds = dancedata.open(odd)
    page = html_of(ds)
    assert "edge151" in page
    assert "groups" not in page  # there is none
    assert "librosa35" in page
    assert page.count("<svg") == min(MOST_CLIPS, len(ds)) == 7
    counts = ds.info["splits"]["train"]
    assert f"<td>train</td><td>{counts['clips']}</td>" in page
    for name in HOSTILE:
        assert name not in page
    assert not re.search(r"<(script|img)", page)


def test_a_part_of_the_clips(odd: Path) -> None:
    clips = dancedata.open(odd).clips()
    assert html_of(clips[:2]).count("<tr>") == 3
    assert html_of(clips[:0]) == "<p>no clips</p>"
    assert "more clip" not in html_of(clips)


def test_a_still_is_the_body_from_the_front() -> None:
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=60)[0]
    turned = motion.joints() @ np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    svg = [
        middle_still(Figure.of_joints(joints, SMPL24, FrameGrid.of(60)), "<a>")
        for joints in (motion.joints(), turned)
    ]
    assert svg[0].replace("-0.0", "0.0") == svg[1].replace("-0.0", "0.0")
    assert 'aria-label="&lt;a&gt;"' in svg[0]
    parts = re.findall(r'fill="(#\w+)" d="M([\d.]+) ([\d.]+)A', svg[0])
    places: dict[str, list[tuple[float, float]]] = {}
    for colour, x, y in parts:
        places.setdefault(colour, []).append((float(x), float(y)))
    assert len(places) == 8  # trunk, left, right and face: the edge and the lit part
    means = {colour: np.mean(of, axis=0) for colour, of in places.items()}
    left, right = max(means, key=lambda colour: means[colour][0]), min(means, key=lambda colour: means[colour][0])
    assert int(left[5:], 16) > int(left[1:3], 16)  # blue: the dancer faces the reader, whose right is his left
    assert int(right[5:], 16) < int(right[1:3], 16)
    points = np.array([place for of in places.values() for place in of])
    assert (points >= 0).all()
    assert (points <= [90, 120]).all()
    assert np.ptp(points, axis=0).max() > 80


def test_importing_dancedata_in_ipython_registers_what_it_shows(odd: Path) -> None:
    shown: dict[tuple[str, str], Callable[[Any], str]] = {}
    html = SimpleNamespace(for_type_by_name=lambda module, name, draw: shown.update({(module, name): draw}))
    shell = SimpleNamespace(display_formatter=SimpleNamespace(formatters={"text/html": html}))
    dancedata.load_ipython_extension(shell)
    ds = dancedata.open(odd)
    for value in (ds, ds.clips(), ds.clips()[0], ds["wav"].motion()):
        assert shown[type(value).__module__, type(value).__name__](value).startswith(("<div>", "<table>", "<iframe "))
    code = (
        "import sys, types; s = types.SimpleNamespace; html = s(for_type_by_name=lambda *_: print('registered'))\n"
        "shell = s(display_formatter=s(formatters={'text/html': html}))\n"
        "sys.modules['IPython'] = s(get_ipython=lambda: shell)\n"
        "import dancedata; assert 'dancedata.viewer' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["registered"] * len(shown)

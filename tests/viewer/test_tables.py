"""Tables of a notebook: datasets and lists of clips, names as text, a still of each clip."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import dancedata
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.scene.figure import Figure
from dancedata.scene.stills import middle_still
from dancedata.synthetic import synthesise_motion
from dancedata.viewer.notebook import MOST_CLIPS, html_of
from tests.scene.helpers import HOSTILE


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

"""Tables of a notebook: datasets and lists of clips, names as text, a still of each clip."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.scene.figure import Figure
from dancedata.synthetic import synthesise_motion
from dancedata.viewer.notebook import MOST_CLIPS, html_of, pose_svg
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


def test_a_still_is_the_pose_from_the_front() -> None:
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=60)[0]
    figure = Figure.of_joints(motion.joints(), SMPL24, FrameGrid.of(60))
    lines = re.findall(r'x1="([\d.]+)" y1="([\d.]+)" x2="([\d.]+)" y2="([\d.]+)"', pose_svg(figure, 10))
    assert len(lines) == len(figure.bones)
    ends = np.array(lines, dtype=np.float64)
    drawn = {b: ends[k, 2:] for k, (_, b) in enumerate(figure.bones)}
    left, right = drawn[SMPL24.index("left_hip")], drawn[SMPL24.index("right_hip")]
    assert left[0] > right[0]  # the dancer faces the reader, whose right is the dancer's left
    heights = figure.joints[10, :, 1]
    low, high = int(heights.argmin()), int(heights.argmax())
    scale = (drawn[low][1] - drawn[high][1]) / (heights[high] - heights[low])
    across = figure.joints[10, SMPL24.index("left_hip")] - figure.joints[10, SMPL24.index("right_hip")]
    assert left[0] - right[0] == pytest.approx(scale * np.hypot(across[0], across[2]), abs=0.15)


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

"""Tables of a notebook: datasets and lists of clips, names as text, a still of each clip."""

import re
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.synthetic import synthesise_motion
from dancedata.viewer import Figure
from dancedata.viewer.tables import MOST_CLIPS, pose_svg
from tests.viewer.helpers import HOSTILE


def test_a_dataset_shows_its_numbers_and_first_clips(odd: Path) -> None:
    ds = dancedata.open(odd)
    page = ds._repr_html_()
    assert "edge151" in page
    assert "groups" not in page  # there is none
    assert "librosa35" in page
    assert page.count("<svg") == min(MOST_CLIPS, len(ds.clips)) == 7
    counts = ds.meta["counts"]["train"]
    assert f"<td>train</td><td>{counts['clips']}</td>" in page
    for name in HOSTILE:
        assert name not in page
    assert not re.search(r"<(script|img)", page)


def test_a_part_of_the_clips(odd: Path) -> None:
    clips = dancedata.open(odd).clips
    assert clips[:2]._repr_html_().count("<tr>") == 3
    assert clips[:0]._repr_html_() == "<p>no clips</p>"
    assert "more clip" not in clips._repr_html_()


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

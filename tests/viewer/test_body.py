"""The floor and the body of a figure, against plain numpy."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.aistpp import AistPP
from dancedata.viewer.figure import Figure
from dancedata.viewer.scenes import Scenes

N = 200
REST = np.zeros((24, 3))
for _joint, _parent in enumerate(SMPL24.parents):
    REST[_joint] = SMPL24.offsets[_joint] + (REST[_parent] if _parent >= 0 else 0)
#: A body that stands on y = 0: SMPL's toe joints lie 2.5 cm above the sole, for a body of 1.7 m.
TALL = Figure.of_joints(REST[None], SMPL24, FrameGrid.of(30)).tall
SOLE = 0.025 * TALL / 1.7
STANDING = REST - (0, REST[[10, 11], 1].mean() - SOLE, 0)


def planted(shift: np.ndarray, contacts: np.ndarray) -> Figure:
    """A body that stands, moved up by `shift` (N,) metres; contacts (N, 4)."""
    joints = STANDING + np.stack([shift * 0, shift, shift * 0], axis=-1)[:, None]
    return replace(Figure.of_joints(joints, SMPL24, FrameGrid.of(30)), contacts=contacts)


def test_a_body_is_as_tall_as_its_bones() -> None:
    assert pytest.approx(1.7, abs=0.1) == TALL
    half = Figure.of_joints(REST[None] / 2, SMPL24, FrameGrid.of(30))
    assert half.tall == pytest.approx(TALL / 2)


def test_the_floor_is_under_the_soles_of_toes_in_contact() -> None:
    shift = np.where(np.arange(N) % 50 < 30, 0.0, 0.3)  # jumps
    shift[40:60] = -0.08  # the capture sinks, as AIST++'s does, without contact
    contacts = np.repeat((shift == 0)[:, None], 4, axis=1)
    figure = planted(shift, contacts)
    assert figure.floor == pytest.approx(np.median(figure.joints[:, [10, 11], 1][contacts[:, 2:]]) - SOLE)
    assert abs(figure.floor) < 0.005
    assert figure.lowest == pytest.approx(np.quantile(figure.joints[:, [7, 8, 10, 11], 1], 0.02))
    assert figure.lowest < figure.floor - 0.02


@pytest.mark.parametrize(("in_contact", "by_contact"), [(21, True), (19, False)])
def test_the_lowest_feet_decide_below_five_per_cent_of_contact(in_contact: int, by_contact: bool) -> None:
    shift = np.linspace(0, 0.15, N)
    contacts = np.zeros((N, 4), dtype=bool)
    contacts[150 : 150 + in_contact // 2, 2:] = True
    contacts[0, 2] = in_contact % 2  # of 2 N labels
    figure = planted(shift, contacts)
    toes = figure.joints[:, [10, 11], 1]
    wanted = (
        np.median(toes[contacts[:, 2:]]) if by_contact else np.quantile(figure.joints[:, [7, 8, 10, 11], 1], 0.02)
    )
    assert figure.floor == pytest.approx(wanted - SOLE)


def test_legs_that_are_held_up_are_not_the_floor() -> None:
    shift = np.where(np.arange(N) < 40, 0.0, 0.9)  # most of the time the feet rest high in the air
    figure = planted(shift, np.ones((N, 4), dtype=bool))
    assert abs(figure.floor) < 0.005


def test_columns_without_toes_take_the_lowest_feet() -> None:
    shift = np.linspace(0, 0.15, N)
    figure = replace(planted(shift, np.ones((N, 2), dtype=bool)), contact_joints=(7, 8))
    assert figure.floor == pytest.approx(figure.lowest - SOLE)


def test_parts_and_copies_of_a_figure_have_floors_of_their_own() -> None:
    figure = planted(np.where(np.arange(N) < N // 2, 0.0, 0.1), np.ones((N, 4), dtype=bool))
    assert figure.part(0, 2).floor == pytest.approx(0, abs=0.005)
    assert figure.part(5, 1).floor == pytest.approx(0.1, abs=0.005)


def test_synthetic_dancers_stand_on_the_floor(scenes: Callable[[str], Scenes]) -> None:
    for item in scenes("thirty").items:
        figure = scenes("thirty").scene(item).figure
        assert figure is not None
        toes = figure.joints[:, [10, 11], 1][figure.contacts[:, 2:]]
        assert np.median(np.abs(toes - SOLE - figure.floor)) < 0.01


def test_real_dancers_stand_on_the_floor(shared: Path) -> None:
    dataset = AistPP(split="all", ignore="none", music="optional")
    clips = dataset.scan(shared / "realdata" / "aistpp").clips
    assert len(clips) == 4
    for clip in clips:
        motion = dataset.load(clip).resampled(FrameGrid.of(30))
        figure = Figure.of_joints(motion.joints(), motion.skeleton, motion.grid)
        toes = figure.joints[:, [10, 11], 1][figure.contacts[:, 2:]]
        assert abs(np.median(toes) - SOLE - figure.floor) < 0.01, clip.id

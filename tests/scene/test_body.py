"""The floor and the limbs of a figure, against plain numpy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dancedata.core.bodies import SMPLX55
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.aistpp import AistPP
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.plot.bodies import cone_outlines
from dancedata.scene.figure import Figure
from dancedata.scene.limbs import Limbs, chest_looks, looks

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


def test_real_dancers_stand_on_the_floor(shared: Path) -> None:
    dataset = AistPP(split="all", ignore="none", music="optional")
    clips = dataset.scan(shared / "realdata" / "aistpp").clips
    assert len(clips) == 4
    for clip in clips:
        motion = dataset.load(clip).resampled(FrameGrid.of(30))
        figure = Figure.of_joints(motion.joints(), motion.skeleton, motion.grid)
        toes = figure.joints[:, [10, 11], 1][figure.contacts[:, 2:]]
        assert abs(np.median(toes) - SOLE - figure.floor) < 0.01, clip.id


def test_the_floor_of_a_capture_that_is_lifted_is_that_of_most_frames(shared: Path) -> None:
    # Rokoko's solver puts the ends of this dance 12 cm lower than the rest (docs/archive/measured.md).
    reading = Reading(Declared(None, "y", "cm"), Declared())
    motion = load_motion(shared / "realdata/bvh/rokoko_jesse_dance.bvh", reading)
    figure = Figure.of_joints(motion.joints(), motion.skeleton, motion.grid)
    toes = figure.joints[:, [10, 11], 1]
    stance = toes[35:65, 1]  # one leg is in the air
    assert np.ptp(stance) < 0.02
    assert abs(stance.mean() - SOLE - figure.floor) < 0.01
    assert figure.lowest == pytest.approx(np.quantile(figure.joints[:, [7, 8, 10, 11], 1], 0.02))
    assert figure.floor - toes[-50:, 0].mean() == pytest.approx(0.11, abs=0.01)


def standing(skeleton: Skeleton = SMPL24) -> np.ndarray:
    """Joints of the rest pose, (1, J, 3)."""
    pose = np.array(skeleton.offsets)
    for joint, parent in enumerate(skeleton.parents[1:], 1):
        pose[joint] += pose[parent]
    return pose[None]


def test_trunk_and_head_are_neutral_and_limbs_have_their_side() -> None:
    tones = dict(zip(SMPL24.joints, Limbs.of(standing()[0], SMPL24).tones, strict=True))
    assert {tones[name] for name in ("spine2", "neck", "head", "left_hip", "right_collar")} == {0}
    assert {tones[name] for name in ("left_knee", "left_foot", "left_shoulder", "left_hand")} == {1}
    assert {tones[name] for name in ("right_knee", "right_wrist")} == {2}


@pytest.mark.parametrize("skeleton", [SMPL24, SMPLX55], ids=["smpl24", "smplx55"])
def test_heads_look_ahead_at_rest_and_turn_with_the_rotations(skeleton: Skeleton) -> None:
    joints = standing(skeleton)
    np.testing.assert_allclose(chest_looks(joints, skeleton)[0], (0, 0, 1), atol=0.12)  # SMPL's shoulders are askew
    rotations = np.zeros((2, skeleton.n_joints, 3))
    rotations[1, skeleton.index("head"), 1] = np.pi / 2  # the head alone, to the left
    motion = Motion(np.zeros((2, 3)), rotations, FrameGrid.of(30), skeleton)
    ahead, aside = looks(motion)
    np.testing.assert_allclose(ahead, (0, 0, 1), atol=0.12)
    np.testing.assert_allclose(aside, (1, 0, 0), atol=0.12)
    np.testing.assert_allclose(chest_looks(motion.joints(), skeleton)[1], chest_looks(joints, skeleton)[0], atol=1e-9)


def test_cones_go_along_the_bones_and_beyond() -> None:
    pose = STANDING
    cones = Limbs.of(pose, SMPL24).cones(pose, np.array([0.0, 0.0, 1.0]))
    bones = np.stack([pose[list(SMPL24.parents[1:])], pose[1:]], axis=1)
    np.testing.assert_array_equal(np.stack([cones.begin, cones.end], axis=1)[:23], bones)
    assert len(cones.begin) == 23 + 6 + 5  # heels, toes and hands; skull, jaw, nose and eyes
    low = (np.minimum(cones.begin[:, 1] - cones.radii[:, 0], cones.end[:, 1] - cones.radii[:, 1])).min()
    assert -0.02 < low < 0.02  # on its soles
    top = (cones.end[:, 1] + cones.radii[:, 1]).max()
    assert top == pytest.approx(pose[15, 1] + 0.17, abs=0.02)
    assert cones.end[-3:, 2].min() > pose[15, 2] + 0.08  # nose and eyes are in front
    assert len(Limbs.of(pose, SMPL24).cones(pose, None).begin) == 23 + 6
    assert set(cones.tones) == {0, 1, 2, 3}


def test_the_outline_of_a_cone_holds_both_circles() -> None:
    begin, end, radii = (
        np.array([[0.0, 0.0], [5.0, 5.0]]), np.array([[40.0, 30.0], [6.0, 5.0]]), np.array([[9, 4], [8, 2.0]]),
    )  # fmt: skip
    outline = cone_outlines(begin, end, radii, 1.0, 0.0)
    for centre, radius in ((begin[0], 9), (end[0], 4)):
        assert np.linalg.norm(outline[0] - centre, axis=1).min() > radius - 0.1
    # One circle inside the other.
    np.testing.assert_allclose(np.linalg.norm(outline[1] - begin[1], axis=1)[:9], 8)
    strip = cone_outlines(begin, end, radii, 0.2, 0.0)[0]
    across = np.array([-0.6, 0.8])
    assert np.abs(strip @ across).max() == pytest.approx(0.2 * np.abs(outline[0] @ across).max())

"""Scores of groups: against the originals' outputs, a search over points, and planted cases."""

import itertools
from collections.abc import Mapping
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from dancedata.core.skeleton import SMPL24
from dancedata.metrics import beat_alignment, geometric, groups, motion_beats, skating
from dancedata.metrics.kinetic_features import KINETIC_VARIANTS
from dancedata.synthetic import synthesise_motion

Array = np.ndarray[Any, np.dtype[np.float64]]


def dancers(n: int = 3, n_frames: int = 60) -> Array:
    names = [f"gBR_sBM_cAll_d0{k}_mBR0_ch01" for k in range(4, 4 + n)]
    joints = np.stack([synthesise_motion(name, n_frames=n_frames)[0].joints() for name in names])
    return joints + np.arange(n)[:, None, None, None] * (1.5, 0, 0)


@pytest.fixture(scope="module")
def golden(crowd_golden: Any) -> Mapping[str, Array]:
    """Groups as GCD's code measures them, a duet as Duolando's does."""
    return crowd_golden("groups")


@pytest.fixture(scope="module")
def scores(crowd_golden: Any) -> Mapping[str, Array]:
    """Tables, a dance and a follower, as GCD's, POPDG's and Duolando's code score them."""
    return crowd_golden("scores")


GROUPS = ("-Ab_cdEf123_01_0_150", "plainid0123_03_0_152", "Zz9_8-7_6Q1_02_300_451")


@pytest.mark.parametrize("name", GROUPS)
def test_groups_as_gcd_measures_them(golden: Mapping[str, Array], name: str) -> None:
    """The originals accumulate float32 positions in float64 as here: 2e-7 apart."""
    joints = golden[f"{name}.joints"]
    np.testing.assert_allclose(groups.group_kinetic(joints, 30), golden[f"{name}.group_kinetic72"], rtol=1e-6)
    np.testing.assert_allclose(groups.group_correlation(joints, 30), golden[f"{name}.gmc"], rtol=1e-6)


def test_a_duet_as_duolando_measures_it(golden: Mapping[str, Array]) -> None:
    follower, leader = golden["follower"], golden["leader"]
    np.testing.assert_allclose(groups.duet_distances(follower, leader), golden["duet100"], atol=1e-6)
    assert groups.beat_echo(leader, follower, 30) == pytest.approx(float(golden["bed"]), rel=1e-12)
    spans = [s for s in groups.contact_spans(leader, follower) if (s.joint, s.other_joint) == (20, 21)]
    assert [(s.start, s.end) for s in spans] == [(19, 51)]  # the made-up hold: 3 cm in the frames 20 ... 50


def test_a_follower_as_duolando_measures_her(golden: Mapping[str, Array], scores: Mapping[str, Array]) -> None:
    """Fingers as two joints, positions from the first pelvis, and y as up: the program's slip, as DD100 has z up."""
    follower = golden["follower"]
    hands = [follower[:, first : first + 15 : 3].mean(axis=1, keepdims=True) for first in (25, 40)]
    body = np.concatenate([follower[:, :22], *hands], axis=1) - follower[:1, :1]
    np.testing.assert_allclose(KINETIC_VARIANTS["code"](body, 30), scores["kinetic72"], rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(geometric(body), scores["manual32"], rtol=1e-4, atol=1e-7)
    found = skating(follower, 30, rule="duolando", up="z")
    assert [found.sliding[0], found.counted[0]] == scores["footskating"].tolist()
    beats = motion_beats(follower, 30, detector="bailando")
    assert beat_alignment(scores["music_beats"], beats, sigma=3) == pytest.approx(float(scores["bas"]), rel=1e-9)


def test_members_order_does_not_matter() -> None:
    joints = dancers()
    expected = groups.group_kinetic(joints, 30), groups.group_correlation(joints, 30)
    for order in permutations(range(3)):
        np.testing.assert_allclose(groups.group_kinetic(joints[list(order)], 30), expected[0], rtol=1e-12)
        np.testing.assert_allclose(groups.group_correlation(joints[list(order)], 30), expected[1], rtol=1e-9)


def test_the_warping_path_of_a_delayed_copy() -> None:
    rows = np.random.default_rng(0).normal(size=(40, 3))
    path = groups.warping_path(rows, np.concatenate([rows[:1].repeat(5, axis=0), rows]))
    assert path[0].tolist() == [0, 0]
    assert path[-1].tolist() == [39, 44]
    assert {tuple(p) for p in path} >= {(k, k + 5) for k in range(40)}
    assert (np.diff(path, axis=0) >= 0).all()


def test_segments_against_a_search_over_points() -> None:
    rng = np.random.default_rng(1)
    p, q, r, s = rng.normal(size=(4, 60, 3))
    q[:20] = p[:20]  # points
    s[20:40] = r[20:40] + 2 * (q - p)[20:40]  # parallel
    steps = np.linspace(0, 1, 101)
    first = p[:, None] + steps[:, None] * (q - p)[:, None]
    second = r[:, None] + steps[:, None] * (s - r)[:, None]
    searched = np.linalg.norm(first[:, :, None] - second[:, None], axis=3).min(axis=(1, 2))
    distances = groups.segment_distances(p, q, r, s)
    assert (distances <= searched + 1e-12).all()
    np.testing.assert_allclose(distances, searched, atol=0.05)


def test_a_planted_contact() -> None:
    first, second = dancers(2)
    second[20:50, 20] = first[20:50, 21] + (0.03, 0, 0)
    (span,) = [s for s in groups.contact_spans(first, second) if (s.joint, s.other_joint) == (21, 20)]
    assert (span.start, span.end) == (20, 50)
    assert span.distance_m == pytest.approx(0.03)
    assert groups.contact_spans(first, second, least_frames=31) == []


def test_boxes_round_limbs_lose_no_collision() -> None:
    rng = np.random.default_rng(5)
    bodies = rng.normal(scale=0.25, size=(2, 300, 22, 3)) + rng.uniform(-0.9, 0.9, size=(2, 300, 1, 3))
    radius = np.asarray(groups.LIMB_RADIUS_M)
    limbs = [(SMPL24.parents[joint], joint) for joint in range(1, 22)]
    near = np.zeros(300, dtype=bool)
    for (p, j), (q, k) in itertools.product(limbs, limbs):
        apart = groups.segment_distances(bodies[0, :, p], bodies[0, :, j], bodies[1, :, q], bodies[1, :, k])
        near |= apart < radius[j] + radius[k]
    assert 20 < near.sum() < 280
    assert (groups.collisions(bodies)[0, 1] == near).all()

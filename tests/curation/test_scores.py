"""Scores of faults, found at their size, against plain numpy and scipy; and repairs."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import theilslopes

from dancedata.core.clip import ClipRef
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.quality import Flag
from dancedata.core.skeleton import SMPL24
from dancedata.curation import anatomy, glitches, repair
from dancedata.curation.repair import LIMITS
from dancedata.curation.scores import MEASURES, Score, score_motion
from dancedata.datasets.aistpp import AistPP
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.metrics.body import bone_spread
from dancedata.synthetic import synthesise_motion

NAME = "gBR_sBM_cAll_d04_mBR0_ch01"
Floats = npt.NDArray[np.float64]


@cache
def dance(name: str = NAME) -> Motion:
    return synthesise_motion(name, n_frames=480)[0]


def moved(path: Floats) -> Motion:
    return replace(dance(), translation=dance().translation + path)


def held_pose(n: int) -> tuple[int, Motion]:
    """Return the first of n frames within a movement that repeat the frame before them, and the dance with them."""
    speed = np.linalg.norm(np.diff(dance().joints(), axis=0), axis=2).max(axis=1) * 60
    start = int(np.flatnonzero(speed[:400] > 1.5)[0]) + 1
    held = {name: np.array(getattr(dance(), name)) for name in ("translation", "rotations")}
    for array in held.values():
        array[start : start + n] = array[start - 1]
    return start, replace(dance(), **held)


def bent(joint: str, by: tuple[float, float, float], frames: slice) -> Motion:
    rotations = np.array(dance().rotations)
    rotations[frames, SMPL24.index(joint)] = np.radians(by)
    return replace(dance(), rotations=rotations)


def score(name: str, motion: Motion) -> Score:
    return score_motion(motion, [name])[name]


def path_of(*parts: tuple[slice, tuple[float, float, float]]) -> Floats:
    path = np.zeros((480, 3))
    for frames, offset in parts:
        path[frames] = offset
    return path


@pytest.mark.parametrize("k", range(4))
def test_clean_clips_have_no_score_above_its_limit(k: int) -> None:
    scores = score_motion(dance(f"gHO_sFM_cAll_d0{k + 1}_mHO{k}_ch0{k + 1}"))
    assert list(scores) == list(MEASURES)
    assert {n for n, s in scores.items() if s.value is not None and s.value > MEASURES[n].limit} == set()


def test_departures_are_those_of_a_cubic_through_four_neighbours() -> None:
    tracks = dance().joints()[:40, :3]
    for width in (1, 2, 3):
        off = glitches._departures(tracks, width)
        for t in (2, 11, 40 - width - 2):
            nodes = [t - 2, t - 1, t + width, t + width + 1]
            for joint in range(3):
                cubic = [np.polynomial.Polynomial.fit(nodes, tracks[nodes, joint, axis], 3) for axis in range(3)]
                expected = np.stack([curve(np.arange(t, t + width)) for curve in cubic], axis=1)
                plain = np.linalg.norm(tracks[t : t + width, joint] - expected, axis=1).min()
                assert off[t, joint] == pytest.approx(plain, abs=1e-9)
        assert not off[:2].any()
        assert not off[40 - width - 1 :].any()


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_a_spike_has_its_frames_and_size(frames: int) -> None:
    found = score("spikes", moved(path_of((slice(200, 200 + frames), (0.06, 0.0, 0.08)))))
    (span,) = found.spans
    assert (span.start, span.end, span.joint) == (200, 200 + frames, "pelvis")
    assert found.value == span.value == pytest.approx(0.1, abs=0.01)  # its own movement is part of it


def test_steps_and_kicks_are_no_spikes() -> None:
    assert score("spikes", moved(path_of((slice(200, None), (0.5, 0.0, 0.0))))).spans == ()
    # 20 cm in a tenth of a second, 80 m/s^2: a kick. As a triangle of three frames, it is a spike.
    kick = np.zeros((480, 3))
    kick[200:212, 0] = 0.1 * (1 - np.cos(2 * np.pi * np.arange(12) / 12))
    assert score("spikes", moved(kick)).spans == ()


def test_jitter_is_no_row_of_spikes() -> None:
    noise = np.random.default_rng(0).normal(0, 0.02, (480, 3))
    assert len(glitches.spikes(moved(noise), 0.03)) < 5
    tracks = moved(noise).joints()[:, 0]
    expected = tracks[2:-2] - (4 * (tracks[1:-3] + tracks[3:-1]) - tracks[:-4] - tracks[4:]) / 6
    assert (np.linalg.norm(expected, axis=1) > 0.03).mean() > 0.5  # most frames are that far off their neighbours


def test_a_pivot_on_the_toe_is_no_slide() -> None:
    rotations = np.repeat(dance().rotations[:1], 480, axis=0)
    still = Motion(np.repeat(dance().translation[:1], 480, axis=0), rotations, FrameGrid.of(60), SMPL24)
    turned = np.array(still.rotations)
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(np.linspace(0, 1, 480)[:, None] * (0.0, 60.0, 0.0))
    turned[:, 0] = (turn * Rotation.from_rotvec(turned[:, 0])).as_rotvec()
    pivot = replace(still, rotations=turned)
    toe = pivot.joints()[:, 10]
    pivot = replace(pivot, translation=pivot.translation - (toe - toe[0]) * (1, 0, 1))
    ankle = np.linalg.norm(np.diff(pivot.joints()[:, 7], axis=0), axis=1) * 60
    assert ankle.min() > 0.3
    assert {span.joint for span in score("sliding", pivot).spans} == {"right_foot"}


def test_a_held_pose_is_frozen_and_a_resting_dancer_is_not() -> None:
    start, held = held_pose(18)
    found = score("frozen", held)
    assert [span[:3] for span in found.spans] == [(start, start + 18, pytest.approx(0.3))]
    same = np.repeat(dance().translation[:1], 480, axis=0), np.repeat(dance().rotations[:1], 480, axis=0)
    assert score("frozen", Motion(*same, FrameGrid.of(60), SMPL24)).spans == ()
    # A dancer who slows down, rests exactly, and goes on.
    rest = 1 - np.cos(np.clip(np.arange(480) - 200, 0, 30) / 30 * np.pi)
    slow = replace(dance(), translation=dance().translation[:1] + 0.1 * rest[:, None], rotations=same[1])
    assert score("frozen", slow).spans == ()


def test_jitter_is_that_of_white_noise() -> None:
    noise = np.random.default_rng(0).normal(0, 0.01, (480, 3))
    # Above 10 of 30 Hz remain two thirds of the variance; the median length of a normal vector is 1.5382 deviations.
    expected = 1.4826 * 1.5382 * 0.01 * np.sqrt(2 / 3)
    sizes = glitches.jitter(moved(noise))
    assert sizes is not None
    assert np.median(sizes) == pytest.approx(expected, rel=0.08)  # the filter's edge is soft
    assert score("jitter", moved(noise)).value > MEASURES["jitter"].limit  # type: ignore[operator]
    # What cannot be measured is not 0.
    assert score("jitter", replace(moved(noise), grid=FrameGrid.of(24))) == Score(None)
    assert score("jitter", moved(noise).part(0, 15)) == Score(None)


def test_a_slide_has_its_length() -> None:
    standing = np.repeat(dance().rotations[:1], 480, axis=0)
    path = np.zeros((480, 3))
    path[:, 2] = np.interp(np.arange(480), [100, 148], [0, 0.8])
    still = Motion(dance().translation[:1] + path, standing, FrameGrid.of(60), SMPL24)
    found = score("sliding", still)
    assert [(s.start, s.end, pytest.approx(0.8)) for s in found.spans] == [s[:3] for s in found.spans]
    assert {s.joint for s in found.spans} == {"left_foot", "right_foot"}
    assert [s[:2] for s in found.spans] == [(100, 149), (100, 149)]
    # At the speed of walking without a step it slides; below 0.3 m/s it does not.
    crawl = replace(still, translation=still.translation * (1, 1, 0.25))
    assert score("sliding", crawl).spans == ()


def test_the_floor() -> None:
    sunk = np.zeros((480, 3))
    sunk[200:230, 1] = -0.2
    joints = moved(sunk).joints()
    lowest = [joints[k : k + 120, list(SMPL24.feet), 1].min() for k in range(0, 480, 120)]
    depth = np.median(lowest) - joints[..., 1]
    found = score("penetration", moved(sunk))
    assert [(s.start, s.end) for s in found.spans] == [(200, 230)]
    assert found.value == pytest.approx(depth.max(), abs=1e-6)
    ramp = np.zeros((480, 3))
    ramp[:, 1] = np.linspace(0, -0.15, 480)
    joints = moved(ramp).joints()[:, list(SMPL24.feet), 1].min(axis=1)
    frames = [k + int(np.argmin(joints[k : k + 120])) for k in range(0, 480, 120)]
    slope = theilslopes(joints[frames], frames)[0]
    trend = anatomy.floor_trend(moved(ramp))
    assert trend is not None
    assert trend[0] == pytest.approx(slope)
    assert score("floor_drift", moved(ramp)).value == pytest.approx(abs(slope) * 479, abs=1e-6)
    assert score("floor_drift", moved(ramp).part(0, 359)) == Score(None)  # less than three stretches of 2 s
    # Heights that do not lie about a line: jumps and steps.
    uneven = np.zeros((480, 3))
    uneven[:, 1] = np.repeat([0.0, 0.25, -0.1, 0.2], 120)
    assert score("floor_drift", moved(uneven)) == Score(0.0)
    # Floor work: one stretch of four lies lower.
    assert score("floor_drift", moved(sunk)).value == pytest.approx(0, abs=0.01)


def test_joint_limits() -> None:
    for joint, by, beyond in (
        ("left_knee", (-70.0, 0.0, 0.0), 35.0),
        ("right_knee", (140.0, 0.0, 0.0), 0.0),
        ("left_elbow", (0.0, 80.0, 0.0), 40.0),
        ("right_elbow", (0.0, -80.0, 0.0), 40.0),
        ("left_elbow", (0.0, -120.0, 0.0), 0.0),
        ("spine1", (100.0, 0.0, 0.0), 25.0),
    ):
        found = score("joint_limits", bent(joint, by, slice(100, 130)))
        # The bones of SMPL's rest pose are up to 5.1 degrees off the axes.
        assert found.value == pytest.approx(beyond, abs=5.2), joint
        assert [s[:2] for s in found.spans] == [(100, 130)] * bool(beyond)
        assert {s.joint for s in found.spans} <= {joint}


def test_self_contact_is_the_distance_of_two_bones() -> None:
    rng = np.random.default_rng(0)
    rotations = np.array(dance().rotations[:200])
    rotations[:, SMPL24.index("left_shoulder")] = rng.normal(0, 1, (200, 3))
    rotations[:, SMPL24.index("left_elbow")] = rng.normal(0, 1, (200, 3))
    joints = replace(dance().part(0, 200), rotations=rotations).joints()
    share = np.linspace(0, 1, 60)
    deepest = np.zeros(200)
    for one, other in anatomy._PAIRS:
        reach = 0.6 * (anatomy.LIMB_RADIUS_M[one] + anatomy.LIMB_RADIUS_M[other])
        a, b = (
            joints[:, SMPL24.parents[j], None] * (1 - share[:, None]) + joints[:, j, None] * share[:, None]
            for j in (one, other)
        )
        apart = np.linalg.norm(a[:, :, None] - b[:, None], axis=-1).min(axis=(1, 2))
        deepest = np.maximum(deepest, reach - apart)
    found = np.zeros(200)
    for span in anatomy.self_contact(joints, 0.0):
        found[span.start : span.end] = np.maximum(found[span.start : span.end], 1)
        assert span.value == pytest.approx(deepest[span.start : span.end].max(), abs=0.004)
    assert found.sum() == pytest.approx((deepest > 0).sum(), abs=2)
    assert found.sum() > 5


def test_sides_and_the_up_axis() -> None:
    assert score("mirrored", dance()).value < -0.5  # type: ignore[operator]
    reflected = replace(
        dance(), rotations=dance().rotations * (1, -1, -1), translation=dance().translation * (-1, 1, 1)
    )
    assert score("mirrored", reflected).value > 0  # type: ignore[operator]
    order = np.arange(24)
    for left, right in SMPL24.pairs:
        order[[left, right]] = right, left
    renamed = Motion(
        dance().translation,
        dance().rotations[:, order],
        FrameGrid.of(60),
        replace(SMPL24, offsets=SMPL24.offsets[order]),
    )
    assert score("mirrored", renamed).value == pytest.approx(-score("mirrored", dance()).value, abs=0.2)  # type: ignore[operator]
    assert score("up", dance()) == Score(0.0)
    from scipy.spatial.transform import Rotation

    quarter, rotations = Rotation.from_euler("x", 90, degrees=True), np.array(dance().rotations)
    rotations[:, 0] = (quarter * Rotation.from_rotvec(rotations[:, 0])).as_rotvec()
    lying = replace(dance(), rotations=rotations, translation=quarter.apply(np.array(dance().translation)))
    assert score("up", lying).value > 0.8  # type: ignore[operator]


def test_bones_of_a_motion_are_as_its_reader_measured() -> None:
    assert score("bone_spread", dance()).value == pytest.approx(0, abs=1e-9)
    assert score("bone_spread", replace(dance(), stretch_m=0.03)).value == 0.03
    joints = dance().joints()
    joints[:, 7] += (joints[:, 7] - joints[:, 4]) * 0.1 * np.sin(np.arange(480) / 9)[:, None]
    lengths = np.linalg.norm(joints[:, 7] - joints[:, 4], axis=1)
    plain = np.quantile(lengths, 0.99) - np.quantile(lengths, 0.01)
    # The bone from the ankle to the toe changes as well, by more.
    assert bone_spread(joints, SMPL24) >= plain > 0.05


def test_a_rig_of_other_joints_has_no_scores_of_a_body() -> None:
    names = tuple(f"joint{k}" for k in range(24))
    scores = score_motion(replace(dance(), skeleton=replace(SMPL24, joints=names)))
    assert {k for k, s in scores.items() if s.value is None} == {"joint_limits", "self_contact", "mirrored", "up"}


@pytest.mark.parametrize("n", [1, 2, 4, 5, 20])
def test_short_motions_have_scores(n: int) -> None:
    scores = score_motion(dance().part(0, n))
    assert {k for k, s in scores.items() if s.value is not None and s.value > MEASURES[k].limit} == set()


def test_real_clips_have_the_faults_that_are_known(shared: Path) -> None:
    """README of realdata: d04 and ch09 have joints that turn by 90 to 177 degrees in a frame; the others do not."""
    spikes = {}
    for path in sorted((shared / "realdata/aistpp/motions").glob("*.pkl")):
        motion = AistPP().load(ClipRef(path.stem, path, None, "train", ""))
        spikes[path.stem] = score("spikes", motion).above(MEASURES["spikes"].limit)
    for name, up, unit in (("rokoko_jesse_dance", "y", "cm"), ("cmu_01_01", "y", "cmu"), ("fair1_dab", "z", "guess")):
        reading = Reading(Declared(None, up, unit), Declared())
        motion = load_motion(shared / f"realdata/bvh/{name}.bvh", reading)
        spikes[name] = score("spikes", motion).above(MEASURES["spikes"].limit)
    assert {name for name, spans in spikes.items() if spans} == {
        "gBR_sBM_cAll_d04_mBR2_ch08",
        "gJS_sFM_cAll_d02_mJS4_ch09",
    }
    assert any(span.start <= 348 < span.end + 2 for span in spikes["gBR_sBM_cAll_d04_mBR2_ch08"])  # its worst turn
    assert any(span.start <= 1450 < span.end for span in spikes["gJS_sFM_cAll_d02_mJS4_ch09"])


# ---- repairs: clean motions come back as they are, every changed frame has a flag


def changed(one: Motion, other: Motion) -> list[int]:
    """Return the frames that differ."""
    differ = (one.rotations != other.rotations).any(axis=(1, 2)) | (one.translation != other.translation).any(axis=1)
    return np.flatnonzero(differ).tolist()


def frames(flags: tuple[Flag, ...], n: int) -> list[int]:
    """Return the frames of flags; those of a whole clip have all."""
    return list(range(n)) if any(f.frame is None for f in flags) else sorted({f.frame for f in flags if f.frame})


def error(one: Motion, other: Motion, where: list[int]) -> float:
    return float(np.linalg.norm(one.joints()[where] - other.joints()[where], axis=2).max())


def test_a_clean_motion_is_returned_itself() -> None:
    repaired = repair.repaired(dance(), LIMITS)
    assert repaired.motion is dance()
    assert repaired.flags == ()


@pytest.mark.parametrize("n", [1, 2, 5])
def test_short_motions_are_returned_themselves(n: int) -> None:
    motion = dance().part(0, n)
    assert repair.repaired(motion, LIMITS).motion is motion


@pytest.mark.parametrize("n", [1, 3])
def test_a_spike_of_the_root_goes(n: int) -> None:
    offset = np.zeros((480, 3))
    offset[200 : 200 + n, 0] = 0.1
    spoilt = moved(offset)
    repaired = repair.repaired(spoilt, LIMITS)
    assert changed(spoilt, repaired.motion) == frames(repaired.flags, 480) == list(range(200, 200 + n))
    assert {(f.kind, f.joint) for f in repaired.flags} == {("repaired_spike", "pelvis")}
    assert np.array_equal(repaired.motion.rotations, spoilt.rotations)
    # 3 mm: how far the dancer leaves a cubic in three frames.
    assert error(dance(), repaired.motion, changed(spoilt, repaired.motion)) < 0.003


def test_a_spike_of_a_wrist_changes_the_joint_above_it_alone() -> None:
    rotations = np.array(dance().rotations)
    rotations[200, 16] += (0.0, 0.0, 0.4)
    spoilt = replace(dance(), rotations=rotations)
    repaired = repair.repaired(spoilt, LIMITS)
    assert [(f.frame, f.joint) for f in repaired.flags] == [(200, "left_shoulder")]
    others = [j for j in range(24) if j != 16]
    assert np.array_equal(repaired.motion.rotations[:, others], spoilt.rotations[:, others])
    assert error(dance(), repaired.motion, [200]) < 0.003


def test_a_gap_is_filled() -> None:
    start, spoilt = held_pose(12)
    repaired = repair.repaired(spoilt, {"gaps": 0.5})
    where = list(range(start, start + 12))
    assert changed(spoilt, repaired.motion) == frames(repaired.flags, 480) == where
    assert {f.kind for f in repaired.flags} == {"repaired_gap"}
    assert error(dance(), repaired.motion, where) < 0.5 * error(dance(), spoilt, where)
    assert repair.repaired(spoilt, {"gaps": 0.1}).motion is spoilt


def test_a_floor_that_sinks_is_levelled() -> None:
    ramp = np.zeros((480, 3))
    ramp[:, 1] = np.linspace(0, -0.15, 480)
    spoilt = moved(ramp)
    repaired = repair.repaired(spoilt, LIMITS)
    assert [(f.kind, f.frame) for f in repaired.flags] == [("repaired_floor", None)]
    assert repaired.flags[0].value == pytest.approx(-0.15, abs=0.01)
    assert repaired.motion.translation[0].tolist() == spoilt.translation[0].tolist()
    assert error(dance(), repaired.motion, list(range(480))) < 0.01
    assert np.array_equal(repaired.motion.translation[:, (0, 2)], spoilt.translation[:, (0, 2)])


def test_jitter_is_smoothed() -> None:
    noise = np.random.default_rng(0).normal(0, 0.01, (480, 3))
    spoilt = moved(noise)
    repaired = repair.repaired(spoilt, {"smoothing": 0.006})
    assert [(f.kind, f.frame) for f in repaired.flags] == [("repaired_jitter", None)]
    off = [np.sqrt(np.mean((m.joints()[:, 0] - dance().joints()[:, 0]) ** 2)) for m in (spoilt, repaired.motion)]
    # A third of the noise's variance lies below 10 of 30 Hz.
    assert off[1] < 0.65 * off[0]
    turned = np.abs(repaired.motion.matrices - dance().matrices).max()
    assert turned < 0.02  # what the dance itself has above 10 Hz


def test_real_clips_get_smaller_spikes_and_no_new_ones(shared: Path) -> None:
    for path in sorted((shared / "realdata/aistpp/motions").glob("*.pkl")):
        motion = AistPP().load(ClipRef(path.stem, path, None, "train", ""))
        repaired = repair.repaired(motion, {"spikes": LIMITS["spikes"]})
        before, after = (score_motion(m, ["spikes"])["spikes"] for m in (motion, repaired.motion))
        limit = MEASURES["spikes"].limit
        assert changed(motion, repaired.motion) == frames(repaired.flags, motion.n_frames)
        assert len(after.above(limit)) <= len(before.above(limit))
        assert after.value <= before.value  # type: ignore[operator]
        assert (repaired.motion is motion) == (not before.above(limit))

"""Repairs: clean motions are returned as they are, and every frame that is changed has a flag."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from dancedata.core.clip import ClipRef
from dancedata.core.motion import Motion
from dancedata.core.quality import Flag
from dancedata.curation import repair
from dancedata.curation.repair import LIMITS
from dancedata.curation.scores import MEASURES, score_motion
from dancedata.datasets.aistpp import AistPP
from dancedata.synthetic import synthesise_motion


@cache
def dance() -> Motion:
    return synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=480)[0]


def changed(one: Motion, other: Motion) -> list[int]:
    """Return the frames that differ."""
    differ = (one.rotations != other.rotations).any(axis=(1, 2)) | (one.translation != other.translation).any(axis=1)
    return np.flatnonzero(differ).tolist()


def frames(flags: tuple[Flag, ...], n: int) -> list[int]:
    """Return the frames of flags; those of a whole clip have all."""
    return list(range(n)) if any(f.frame is None for f in flags) else sorted({f.frame for f in flags if f.frame})


def error(one: Motion, other: Motion, where: list[int]) -> float:
    return float(np.linalg.norm(one.joints()[where] - other.joints()[where], axis=2).max())


def with_root(offset: np.ndarray) -> Motion:
    return replace(dance(), translation=dance().translation + offset)


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
    spoilt = with_root(offset)
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
    speed = np.linalg.norm(np.diff(dance().joints(), axis=0), axis=2).max(axis=1) * 60
    start = int(np.flatnonzero(speed[:400] > 1.5)[0]) + 1
    held = {name: np.array(getattr(dance(), name)) for name in ("translation", "rotations")}
    for array in held.values():
        array[start : start + 12] = array[start - 1]
    spoilt = replace(dance(), **held)
    repaired = repair.repaired(spoilt, {"gaps": 0.5})
    where = list(range(start, start + 12))
    assert changed(spoilt, repaired.motion) == frames(repaired.flags, 480) == where
    assert {f.kind for f in repaired.flags} == {"repaired_gap"}
    assert error(dance(), repaired.motion, where) < 0.5 * error(dance(), spoilt, where)
    assert repair.repaired(spoilt, {"gaps": 0.1}).motion is spoilt


def test_a_floor_that_sinks_is_levelled() -> None:
    ramp = np.zeros((480, 3))
    ramp[:, 1] = np.linspace(0, -0.15, 480)
    spoilt = with_root(ramp)
    repaired = repair.repaired(spoilt, LIMITS)
    assert [(f.kind, f.frame) for f in repaired.flags] == [("repaired_floor", None)]
    assert repaired.flags[0].value == pytest.approx(-0.15, abs=0.01)
    assert repaired.motion.translation[0].tolist() == spoilt.translation[0].tolist()
    assert error(dance(), repaired.motion, list(range(480))) < 0.01
    assert np.array_equal(repaired.motion.translation[:, (0, 2)], spoilt.translation[:, (0, 2)])


def test_jitter_is_smoothed() -> None:
    noise = np.random.default_rng(0).normal(0, 0.01, (480, 3))
    spoilt = with_root(noise)
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

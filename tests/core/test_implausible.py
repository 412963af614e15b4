"""Flags of clips: units that make no dancer, rates that are stated wrongly, frames that come twice."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.bodies import SKELETONS
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.quality import body_size, implausible_flags
from dancedata.core.rates import rate_factor, repeats
from dancedata.core.registry import DATASETS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.aistpp import AistPP
from dancedata.synthetic import synthesise_motion
from tests.datasets.scans import load


def sized(factor: float) -> Skeleton:
    return Skeleton("sized", SMPL24.joints, SMPL24.parents, SMPL24.offsets * factor, SMPL24.pairs, SMPL24.feet)


@pytest.fixture(scope="module")
def dance() -> Motion:
    return synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=240)[0]


def kinds(motion: Motion) -> list[tuple[str, float]]:
    return [(flag.kind, flag.value) for flag in implausible_flags(motion)]


@pytest.mark.parametrize("name", sorted(SKELETONS))
def test_bodies_that_come_with_the_package_are_plausible(name: str) -> None:
    assert 1.4 < body_size(SKELETONS[name]) < 1.8


@pytest.mark.parametrize("unit", [0.001, 0.01, 0.0254, 0.0254 / 0.45])
def test_a_translation_in_another_unit(dance: Motion, unit: float) -> None:
    # A metre taken for an inch, or for CMU's unit, makes 3 m of small movements: not every dance shows it.
    for factor in (unit, 1 / unit) if unit <= 0.01 else (unit,):
        motion = Motion(dance.translation * factor, dance.rotations, dance.grid, dance.skeleton)
        ((kind, value),) = kinds(motion)
        assert kind == "implausible_root"
        assert value == pytest.approx(factor, rel=0.3)


def test_columns_without_the_root(dance: Motion) -> None:
    root_taken_out = np.zeros_like(dance.translation)
    assert kinds(Motion(root_taken_out, dance.rotations, dance.grid, dance.skeleton)) == []
    still = np.zeros_like(dance.rotations)
    assert kinds(Motion(dance.translation, still, dance.grid, dance.skeleton)) == []
    jumping = dance.translation + np.array([0, 1, 0]) * np.abs(np.sin(np.arange(240) / 40))[:, None]
    assert kinds(Motion(jumping, dance.rotations, dance.grid, dance.skeleton)) == []


@pytest.mark.parametrize("name", ["aist++", "finedance", "folder"])
def test_examples_of_all_readers_are_plausible(tmp_path: Path, name: str) -> None:
    reader: Any = DATASETS.get(name)()
    reader.make_example(tmp_path)
    clips = reader.scan(tmp_path).clips
    assert clips
    assert [kinds(reader.load(clip)) for clip in clips] == [[]] * len(clips)


def jumps(rate: float, seconds: float = 6, up_m_s: float = 2.5) -> Float64Array:
    """Return joints of a body that jumps once a second, and rises on its toes between."""
    time = np.arange(0, seconds, 1 / rate) % 1
    air = np.maximum(up_m_s * time - 9.81 / 2 * time**2, 0)
    standing = 0.02 * np.sin(12 * time) * (air == 0)
    path = np.stack([0 * time, air + standing, 0.3 * time], axis=1)
    return Motion(path, np.zeros((len(time), 24, 3)), FrameGrid.of(rate), SMPL24).joints()


@pytest.mark.parametrize("rate", [30, 60, 120])
@pytest.mark.parametrize("factor", [0.5, 2, 4])
def test_jumps_show_a_wrong_rate(rate: float, factor: float) -> None:
    joints = jumps(rate)
    assert rate_factor(joints, rate) is None
    assert rate_factor(joints, rate * 24 / 30) is None
    found = rate_factor(joints, rate * factor)
    assert found == pytest.approx(factor, rel=0.1)


@pytest.mark.parametrize("name", ["gLO_sFM_cAll_d13_mLO3_ch10", "gMH_sFM_cAll_d22_mMH3_ch10"])
def test_a_body_sinks_no_faster_than_it_falls(name: str) -> None:
    joints = synthesise_motion(name, n_frames=600)[0].joints()
    assert rate_factor(joints, 60) is None
    found = rate_factor(joints, 120)
    assert found is not None
    assert found > 1.4


def test_calm_or_short_motion_shows_nothing() -> None:
    still = np.tile(jumps(60)[:1], (200, 1, 1))
    rising = still + np.linspace(0, 2, 200)[:, None, None] * (0, 1, 0)
    for joints in (still, rising, jumps(60)[:3], jumps(60)[:1]):
        assert rate_factor(joints, 60) is None
        assert repeats(joints) is None


def test_real_dances_have_their_own_rate(shared: Path) -> None:
    found = {}
    for path in sorted((shared / "realdata" / "aistpp" / "motions").glob("*.pkl")):
        joints = load(AistPP(), path).joints()
        assert rate_factor(joints, 60) is None, path.name
        assert repeats(joints) is None, path.name
        found[path.name[:16]] = (rate_factor(joints, 30) is not None, rate_factor(joints, 120) is not None)
    assert found["gBR_sBM_cAll_d04"] == found["gBR_sBM_cAll_d06"] == (True, True)
    assert sum(high for _, high in found.values()) == 3


@pytest.mark.parametrize("times", [2, 3, 4])
def test_frames_that_all_come_several_times(times: int) -> None:
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0]
    noise = np.random.default_rng(0).normal(0, 1e-8, (120 * times, 1, 3))
    joints = np.repeat(motion.joints(), times, axis=0) + noise
    assert repeats(joints) == times
    assert repeats(motion.joints()) is None
    assert repeats(joints[5:]) == times
    # A dancer who stands still between: 24 frames of 25 of a film are no repetition of all.
    assert repeats(np.concatenate([motion.joints(), np.tile(motion.joints()[-1:], (200, 1, 1))])) is None
    some = np.repeat(motion.joints(), np.where(np.arange(120) % 4, 1, 2), axis=0)
    assert repeats(some) is None


def test_both_are_flags_of_the_clip() -> None:
    motion = synthesise_motion("gLO_sFM_cAll_d13_mLO3_ch10", n_frames=600)[0]
    stated = Motion(motion.translation, motion.rotations, FrameGrid.of(120), motion.skeleton)
    twice = Motion(
        *(np.repeat(a, 2, axis=0) for a in (motion.translation, motion.rotations)), FrameGrid.of(120), SMPL24
    )
    for made, kind in ((stated, "doubtful_rate"), (twice, "repeated_frames")):
        (flag,) = [flag for flag in implausible_flags(made) if flag.kind in ("doubtful_rate", "repeated_frames")]
        assert (flag.kind, flag.joint, flag.frame, flag.rate) == (kind, "", None, "120")
    assert implausible_flags(motion) == []

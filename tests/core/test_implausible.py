"""Flags of clips whose unit makes no dancer: bodies by their bones, translations by the pose."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.bodies import SKELETONS
from dancedata.core.motion import Motion
from dancedata.core.quality import body_size, implausible_flags
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.synthetic import synthesise_motion


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

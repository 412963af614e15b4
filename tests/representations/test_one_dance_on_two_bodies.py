"""The same dance read from an AMASS file (SMPL-H) and from a SMPL-X file: the same columns."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.clip import ClipRef
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder import Folder
from dancedata.evaluation.measuring import conformed
from dancedata.evaluation.protocol import MotionRule
from dancedata.formats.motion_files import amass_arrays, smplx_arrays
from dancedata.scene.poses import Pose
from dancedata.synthetic import synthesise_motion

ALL = [
    ("edge151", {}), ("fact219", {}), ("bailando72", {}), ("lodge139", {}), ("lodge319", {}), ("finedance319", {}),
    ("joints", {}), ("joints", {"body": "smplx22"}), ("joints", {"body": "smplx52"}), ("joints", {"body": "smplx55"}),
]  # fmt: skip
NAMES = [name + "".join(f"-{value}" for value in kw.values()) for name, kw in ALL]


def written(folder: Path, motion: Motion) -> dict[str, Motion]:
    """Return a motion as it is read from an AMASS file and from a SMPL-X file; the pelvis is the same in both."""
    read = {}
    for kind, arrays in (("amass", amass_arrays(motion)), ("smplx", smplx_arrays(motion))):
        path = folder / f"{kind}.npz"
        np.savez(path, **arrays)
        read[kind] = Folder(music="optional").load(ClipRef(kind, path, None, "test"))
        np.testing.assert_allclose(read[kind].joints()[:, 0], motion.joints()[:, 0], atol=1e-9)
    return read


@pytest.fixture(scope="module")
def dances(tmp_path_factory: Any) -> list[dict[str, Motion]]:
    """Two synthetic dances; the second is higher up, turned, and without still feet."""
    first = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0]
    rotations = np.array(first.rotations)
    rotations += np.random.default_rng(1).normal(0, 0.2, (1, 24, 3))
    second = Motion(np.add(first.translation, (0.3, 0.7, -2.0)), rotations, first.grid, SMPL24)
    folders = [tmp_path_factory.mktemp("dance") for _ in range(2)]
    return [
        {"smpl": motion, **written(folder, motion)} for motion, folder in zip((first, second), folders, strict=True)
    ]


@pytest.mark.parametrize(("name", "parameters"), ALL, ids=NAMES)
def test_columns_are_the_same(dances: list[dict[str, Motion]], name: str, parameters: dict[str, Any]) -> None:
    for dance in dances:
        smpl, amass, smplx = (dancedata.encode(motion, name, **parameters) for motion in dance.values())
        assert np.abs(amass - smplx).max() < 2e-6  # 11 cm, where the translation kept its numbers
        if name == "joints":
            # SMPL's hands are joints of the 24 alone.
            assert np.abs(smpl - smplx)[:, : 3 * 22].max() < 2e-6


@pytest.mark.parametrize("pelvis", ["body", "translation"])
def test_a_protocol_measures_the_same_positions(dances: list[dict[str, Motion]], pelvis: Any) -> None:
    for body in ("smpl24", "smplx24"):
        rule = MotionRule(body, None, pelvis=pelvis)
        for dance in dances:
            amass, smplx = (conformed(Pose.of_motion(dance[kind]), rule)[0].joints for kind in ("amass", "smplx"))
            np.testing.assert_allclose(amass, smplx, atol=1e-9)
        rest = SMPL24.offsets[0] if pelvis == "translation" and body == "smpl24" else 0
        if body == "smpl24":
            np.testing.assert_allclose(smplx[:, 0], dance["smpl"].joints()[:, 0] - rest, atol=1e-9)


@pytest.mark.parametrize("name", ["aist++", "synthetic", "finedance", "folder"])
def test_the_body_is_known_before_the_motion_is_read(tmp_path: Path, name: str) -> None:
    dataset = DATASETS.get(name)()
    dataset.make_example(tmp_path)
    clips = dataset.scan(tmp_path).clips
    assert len(clips) >= 2
    for clip in clips:
        body, skeleton = dataset.body_of(clip), dataset.load(clip).skeleton
        assert body is not None
        assert body.joints == skeleton.joints
        np.testing.assert_array_equal(body.offsets[0], skeleton.offsets[0])

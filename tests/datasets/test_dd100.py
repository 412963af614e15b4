"""The dataset reader dd100: pairs, roles, the split's rule, axes; joints against Duolando's."""

import shutil
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.errors import DataError
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.dd100 import DD100, is_test
from tests.datasets.scans import load, notes, rejects, splits
from tests.messages import raises_message

READER = DD100


def file_of(source: Path, name: str) -> Path:
    return source / "motion" / "smplx" / "all" / f"{name}.npy"


def change(path: Path, **changes: Any) -> None:
    """Replace values of a file; None removes a key."""
    cell = np.load(path, allow_pickle=True)
    content = {**cell[()], **changes}
    cell[()] = {key: value for key, value in content.items() if value is not None}
    np.save(path, cell, allow_pickle=True)


def test_scan(source: Path) -> None:
    scan = DD100().scan(source)
    assert [clip.id for clip in scan.clips[:2]] == ["Ballet_9_0_00", "Ballet_9_0_01"]
    splits = {clip.group: clip.split for clip in scan.clips}
    assert splits == {"Ballet_9_0": "test", "Waltz_5_0": "test", "Waltz_6_0": "train"}
    follower, leader = scan.clips[:2]
    assert (follower.member, follower.role, leader.member, leader.role) == (0, "follower", 1, "leader")
    assert (leader.group, leader.music, leader.genre) == ("Ballet_9_0", "Ballet_9_0", "Ballet")
    assert (leader.keys, leader.lists) == ((("choreography", "Ballet_9"),), ("test",))
    assert not scan.rejects
    assert "by motion/smplx/ (6 files); 3 audio files" in notes(scan)
    assert "Axes: +Z up, turned to +Y" in notes(scan)


def test_the_rule_of_duolando(source: Path) -> None:
    names = ("Ballet_9_1", "Ballet_10_0", "Ballet_5_0", "Waltz_10_0", "Waltz_9_0")
    assert [is_test(name) for name in names] == [True, True, False, True, False]
    for path in [*source.rglob("Waltz_5_0*.npy"), *source.rglob("Waltz_5_0*.wav")]:
        for take in range(1, 5):
            shutil.copy(path, path.with_name(path.name.replace("Waltz_5_0", f"Waltz_5_{take}")))
    clips = DD100(split="by-choreography").scan(source).clips
    assert len({clip.group for clip in clips if "Waltz_5" in str(clip.group)}) == 5
    assert {clip.split for clip in clips if "Waltz_5" in str(clip.group)} == {"train"}


def test_files_without_partner(source: Path) -> None:
    file_of(source, "Ballet_9_0_00").unlink()
    file_of(source, "Waltz_5_0_02").write_bytes(b"")
    copied = source / "motion" / "smplx" / "train"
    copied.mkdir()
    (copied / "Waltz_6_0_00.npy").write_bytes(file_of(source, "Waltz_6_0_00").read_bytes())
    scan = DD100().scan(source)
    assert set(splits(scan)) == {f"{name}_0{k}" for name in ("Waltz_5_0", "Waltz_6_0") for k in (0, 1)} | {
        "Ballet_9_0_01"
    }
    assert {clip.group_size for clip in scan.clips} == {2}
    assert rejects(scan, "missing_partner") == ["Ballet_9_0_00"]
    extra = ["motion/smplx/all/Waltz_5_0_02.npy", "motion/smplx/train/Waltz_6_0_00.npy"]
    assert rejects(scan, "extra_file") == extra


def test_both_in_one_world_with_y_up(source: Path) -> None:
    scan = DD100().scan(source)
    follower, leader = (DD100().load(ref).joints() for ref in scan.clips[:2])
    assert len(follower) - len(leader) == 3
    for joints in (follower, leader):
        assert (joints[:, 15, 1] - joints[:, 0, 1]).min() > 0.3
    apart = np.linalg.norm(follower[:243, 0] - leader[:243, 0], axis=-1)
    raw = [np.load(ref.motion_path, allow_pickle=True)[()]["transl"][:243] for ref in scan.clips[:2]]
    np.testing.assert_allclose(apart, np.linalg.norm(raw[0] - raw[1], axis=-1), atol=1e-6)


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("bad_shape", {"poses": np.zeros((246, 156))}), ("contradiction", {"global_orient": np.ones((246, 3))}),
        ("unsafe_pickle", {"meta": Fraction(1)}),
    ],
)  # fmt: skip
def test_files_that_cannot_be_used(source: Path, reason: str, changes: dict[str, Any]) -> None:
    path = file_of(source, "Ballet_9_0_00")
    change(path, **changes)
    with raises_message(DataError, "poses|transl", reason=reason):
        load(DD100(), path)


def test_another_axis_is_refused_and_other_arrays(source: Path) -> None:
    path = file_of(source, "Ballet_9_0_00")
    with raises_message(DataError, "pelvises", where="Ballet_9_0_00.npy", reason="bad_axes"):
        load(DD100(up="y"), path)
    np.save(path, np.zeros((246, SMPL24.n_joints)))
    with raises_message(DataError, r"numpy\.save", where="Ballet_9_0_00.npy", reason="bad_shape"):
        load(DD100(), path)


def test_joints_of_duolando(shared: Path) -> None:
    crowd = shared / "golden" / "crowd"
    wanted = np.load(crowd / "duolando" / "dd100.npz")
    scan = DD100().scan(crowd / "inputs" / "dd100")
    assert len(scan.clips) == 8
    for ref in scan.clips:
        joints = DD100().load(ref).joints()
        z_up = np.stack([joints[..., 0], -joints[..., 2], joints[..., 1]], axis=-1).reshape(len(joints), -1)
        if f"{ref.id}.pos3d" in wanted:
            np.testing.assert_allclose(z_up, wanted[f"{ref.id}.pos3d"], atol=1e-5)
        else:
            rows = z_up[[0, 1, -2, -1]]
            np.testing.assert_allclose(rows, wanted[f"{ref.id}.pos3d_first_last"], atol=1e-5)

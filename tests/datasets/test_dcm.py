"""The dataset reader dcm: names by pattern, lists in JSON, joints of bones."""

import json
from pathlib import Path

import numpy as np

from dancedata.core.errors import DataError
from dancedata.datasets._examples import dance
from dancedata.datasets.dcm import DCM, UNIT_M, content_of
from tests.datasets.scans import load, notes, rejects, splits
from tests.messages import raises_message

READER = DCM


def test_scan(source: Path) -> None:
    scan = DCM().scan(source)
    assert splits(scan) == {"10_2": "val", "11": "train", "1_0": "test", "4_0": "train", "4_1": "train"}
    clip = scan.clips[-1]
    assert (clip.id, clip.music, clip.genre, clip.keys) == ("4_1", "4", "Chinese", (("sequence", "4"),))
    assert clip.audio_path is not None
    assert clip.audio_path.name == "a4_1.wav"
    assert not scan.rejects


def test_lists_that_share_a_sequence(source: Path) -> None:
    for split, names in (("train", ["C_4_0", "C_9_9"]), ("test", ["C_4_1"])):
        (source / "split" / f"{split}.json").write_text(json.dumps(names))
    audio = source / "amc_aligned_data_split" / "Audio"
    (audio / "a4_1.wav").rename(audio / "b4_1.wav")
    scan = DCM().scan(source)
    assert "Leak: 1 of 1 test are of sequences of train (4)" in notes(scan)
    assert rejects(scan, "missing_motion") == ["9_9"]
    assert rejects(scan, "missing_music") == ["4_1"]
    assert rejects(scan, "unassigned") == ["11", "1_0"]
    assert rejects(scan, "extra_file") == ["amc_aligned_data_split/Audio/b4_1.wav"]
    assert len({DCM(split="by-sequence", music="optional").scan(source).clips[k].split for k in (-2, -1)}) == 1


def test_joints_are_the_places_of_bones(source: Path) -> None:
    """DanceCamera3D takes numbers 12 to 14 of the 16 of each bone."""
    path = source / "amc_aligned_data_split" / "Simplified_MotionGlobalTransform" / "m4_0_gt.json"
    frames = json.loads(path.read_text())["BoneKeyFrameTransformRecord"]
    bones = np.array([[frame["Transform"][16 * k + 12 : 16 * k + 15] for k in range(60)] for frame in frames])
    joints = load(DCM(), path).joints()
    for joint, bone in ((0, 0), (4, 9), (7, 10), (12, 3), (18, 19), (21, 42)):
        off = np.linalg.norm(joints[:, joint] - UNIT_M * bones[:, bone], axis=-1)
        assert np.median(off) < 0.02, joint


def test_a_body_upside_down(tmp_path: Path) -> None:
    content = content_of(dance("gBR_sBM_cAll_d04_mBR0_ch01", 181))
    for frame in content["BoneKeyFrameTransformRecord"]:
        frame["Transform"][13::16] = [-y for y in frame["Transform"][13::16]]
    (tmp_path / "m1_gt.json").write_text(json.dumps(content))
    with raises_message(DataError, "upright", where="m1_gt.json", reason="bad_axes"):
        load(DCM(), tmp_path / "m1_gt.json")

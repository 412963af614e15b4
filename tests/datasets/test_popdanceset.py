"""The dataset reader popdanceset: lists and what they share, scale, axes, matrices; columns against POPDG's."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dancedata.contacts.velocity import Velocity
from dancedata.core.errors import DataError
from dancedata.core.skeleton import SMPL24_EDGE
from dancedata.datasets.popdanceset import PopDanceSet
from dancedata.representations.edge151 import Edge151
from tests.datasets.scans import change_pickle, load, notes, rejects, splits
from tests.messages import raises_message

READER = PopDanceSet

FIRST, SECOND = "BVaaaaaaaa1a_Clip_1", "BVaaaaaaaa1a_Clip_2"
MATRICES, TEST = "BVbbbbbbbb2b_Clip_1", "BVcccccccc3c_Clip_7"


def test_scan(source: Path) -> None:
    scan = PopDanceSet().scan(source)
    assert splits(scan) == {FIRST: "train", SECOND: "train", MATRICES: "train", TEST: "test"}
    first = scan.clips[0]
    assert (first.music, first.dancer, first.keys) == ("BVaaaaaaaa1a", "BVaaaaaaaa1a", (("video", "BVaaaaaaaa1a"),))
    assert (first.lists, scan.clips[1].lists) == (("train", "high_quality"), ("train",))
    assert not scan.rejects
    assert "Splits: official: 3 train, 1 test, 1 high_quality; no val." in notes(scan)
    assert "Leak" not in notes(scan)
    assert "Scale: none" in notes(scan)
    assert "Scale: translation x pred_camera" in notes(PopDanceSet(scale="multiply").scan(source))


def test_what_the_lists_share(source: Path) -> None:
    (source / "splits" / "test.txt").write_text(f"{SECOND}\n{TEST}")
    (source / "splits" / "train.txt").write_text(f"{FIRST}\n{MATRICES}\nBVcccccccc3c_Clip_8")
    scan = PopDanceSet().scan(source)
    assert "Leak: 2 of 2 test are of videos of train (BVaaaaaaaa1a, BVcccccccc3c)" in notes(scan)
    assert rejects(scan, "missing_motion") == ["BVcccccccc3c_Clip_8"]
    by_video = PopDanceSet(split="by-video").scan(source)
    assert splits(by_video)[FIRST] == splits(by_video)[SECOND]
    assert "Leak of the official lists, which are not used" in notes(by_video)
    for path in (source / "splits").iterdir():
        path.rename(source / path.name)  # lists beside the motion
    assert splits(PopDanceSet().scan(source)) == splits(scan)


def test_motion_stands_upright_in_metres(source: Path) -> None:
    path = source / "motions" / f"{FIRST}.pkl"
    content = pickle.loads(path.read_bytes())
    motion = load(PopDanceSet(), path)
    assert (motion.n_frames, motion.grid.rate, motion.skeleton) == (181, 30, SMPL24_EDGE)
    np.testing.assert_allclose(motion.translation, content["transl"] * [1, -1, -1], atol=1e-6)
    joints = motion.joints()
    assert (joints[:, 15, 1] > joints[:, 0, 1]).all(), "the head is above the pelvis"
    scaled = load(PopDanceSet(scale="multiply"), path)
    expected = content["transl"] * content["pred_camera"] * [1, -1, -1] + [0, 1, 5]
    np.testing.assert_allclose(scaled.translation, expected, atol=1e-5)
    np.testing.assert_array_equal(scaled.rotations, motion.rotations)
    change_pickle(path, pred_camera=None)
    assert load(PopDanceSet(), path).n_frames == 181, "without scale it is not read"


@pytest.mark.parametrize("shape", [(180, 24, 3), (180, 216), (180, 24, 3, 3), (180, 24, 9)])
def test_shapes_of_rotations(source: Path, shape: tuple[int, ...]) -> None:
    path = source / "motions" / f"{SECOND}.pkl"
    expected = load(PopDanceSet(), path).joints()
    thetas = pickle.loads(path.read_bytes())["pred_thetas"].astype(np.float64)
    if np.prod(shape[1:]) == 216:
        thetas = Rotation.from_rotvec(thetas.reshape(-1, 3)).as_matrix()
    change_pickle(path, pred_thetas=thetas.reshape(shape))
    np.testing.assert_allclose(load(PopDanceSet(), path).joints(), expected, atol=1e-6)


def bad(key: str, array: Any) -> Any:
    return lambda content: {key: array(content[key])}


@pytest.mark.parametrize(
    ("reason", "make"),
    [
        ("missing_key", lambda c: {"pred_camera": None}),
        ("bad_shape", bad("pred_camera", lambda a: np.repeat(a, 3, axis=1))),
        ("length_mismatch", bad("pred_camera", lambda a: a[1:])),
        ("bad_rotation", lambda c: {"pred_thetas": np.tile(np.diag([1.0, 1.0, -1.0]), (len(c["transl"]), 24, 1, 1))}),
    ],
)
def test_bad_files(source: Path, reason: str, make: Any) -> None:
    path = source / "motions" / f"{FIRST}.pkl"
    change_pickle(path, **make(pickle.loads(path.read_bytes())))
    with raises_message(DataError, "matrix|pred_camera", reason=reason):
        load(PopDanceSet(scale="multiply"), path)


def test_columns_are_popdgs(shared: Path) -> None:
    crowd = shared / "golden" / "crowd"
    reader = PopDanceSet(scale="multiply")
    refs = {clip.id: clip for clip in reader.scan(crowd / "inputs" / "popdanceset").clips}
    facts = json.loads((crowd / "popdg" / "facts.json").read_text())
    arrays = np.load(crowd / "popdg" / "windows.npz")
    unsure = {tuple(place) for place in facts["contacts_too_near_to_call"]}
    joints = [7, 8, 10, 11, 15, 20, 21, 22, 23]
    ends = [0, 1, 148, 149]
    for split in ("train", "test"):
        for w, name in enumerate(facts["order"][split]):
            clip, piece = name.rsplit("_slice", 1)
            window = reader.load(refs[clip]).part(15 * int(piece), 15 * int(piece) + 150)
            columns, expected = (
                Edge151().encode(window, Velocity(max_speed_m_s=0.3)),
                arrays[f"{split}.raw_first_last"][w],
            )
            np.testing.assert_allclose(columns[ends, 4:], expected[:, :147], atol=1e-5)
            places = window.joints()[:, joints]
            steps = np.linalg.norm(np.diff(places, axis=0, append=places[-1:]), axis=-1)
            wrong = np.argwhere((steps < 0.01) != arrays[f"{split}.contacts"][w])
            assert {(name, int(frame), int(column)) for frame, column in wrong} <= unsure
        if split == "train":
            clip = facts["order"][split][0].rsplit("_slice", 1)[0]
            columns = Edge151().encode(reader.load(refs[clip]).part(0, 150), Velocity(max_speed_m_s=0.3))
            np.testing.assert_allclose(columns[:, 4:], arrays["train.raw_0"][:, :147], atol=1e-5)

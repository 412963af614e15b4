"""The dataset reader i-dancers: lists, rate and axis that are not published, rotation matrices, groups in builds."""

import pickle
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.spatial.transform import Rotation

import dancedata
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.i_dancers import IDancers, content_of, load_motions
from dancedata.synthetic import synthesise_motion
from dancedata.torch import GroupDataset
from tests.datasets.scans import notes, rejects, replaced, splits
from tests.messages import raises_message

READER = IDancers

DANCE, _ = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=121)
DANCE = DANCE.resampled(FrameGrid.of(30))
RATE, BOTH = Fraction(30), (0, 1)


def write(path: Path, content: Any) -> Path:
    path.write_bytes(pickle.dumps(content, protocol=4))
    return path


def test_scan(source: Path) -> None:
    scan = IDancers().scan(source)
    assert not scan.rejects
    split_of = {clip.group: clip.split for clip in scan.clips}
    assert split_of == {"seq_001": "train", "seq_002": "train", "seq 010": "test"}
    assert [clip.id for clip in scan.clips if clip.group == "seq_002"] == [f"seq_002_p{k}" for k in range(3)]
    assert scan.clips[0].audio_path == source / "music" / "seq 010.wav"
    assert "Rate: 30 frames per second, by the lengths of motion and music." in notes(scan)
    assert splits(IDancers().scan(source / "motion" / "..")) == splits(scan)


def test_lists_and_files_that_do_not_agree(source: Path) -> None:
    (source / "train.txt").write_text("seq_001\nseq_007_smpl.pkl", encoding="utf-8")
    (source / "music" / "seq 010.wav").unlink()
    scan = IDancers().scan(source)
    assert {clip.group for clip in scan.clips} == {"seq_001"}
    assert rejects(scan, "unassigned") == ["seq_002"]
    assert rejects(scan, "missing_motion") == ["seq_007"]
    assert rejects(IDancers(music="optional").scan(source), "missing_music") == ["seq 010"]


@pytest.mark.parametrize("share", [0.5, 0.9, 1.2, 1.25, 1.5])  # as long at 60, none, 25, 24, 20 FPS
def test_the_rate_is_told_by_the_music_of_most_or_asked_for(source: Path, share: float) -> None:
    """A song that goes on after its dance, or is cut, does not make the dance slower or faster."""
    sound, rate = soundfile.read(source / "music" / "seq_001.wav")
    soundfile.write(source / "music" / "seq_001.wav", np.tile(sound, 2)[: int(len(sound) * share)], rate)
    scan = IDancers().scan(source)
    assert {clip.group: dict(clip.declared)["fps"] for clip in scan.clips} == {"seq_002": "30", "seq 010": "30"}
    assert rejects(scan, "unknown_rate") == ["seq_001"]
    assert "Rate: 30 frames per second" in notes(scan)
    asked = IDancers(fps="30000/1001").scan(source)
    assert {dict(clip.declared)["fps"] for clip in asked.clips} == {"30000/1001"}
    assert not asked.rejects
    # One at 30, one at another rate: nobody knows.
    (source / "motion" / "seq 010_smpl.pkl").unlink()
    if share != 0.9:
        assert rejects(IDancers().scan(source), "unknown_rate") == ["seq_001", "seq_002"]


def test_dancers_stay_in_one_world(tmp_path: Path) -> None:
    content = content_of(DANCE, 3)
    content["smpl_poses"] *= np.float32(1 + 3e-7)  # within the tolerance of rotation matrices
    dancers = load_motions(write(tmp_path / "a_smpl.pkl", content), range(3), RATE)
    for k, dancer in enumerate(dancers):
        place = DANCE.joints() + np.array([1.2 * k, 0.0, 0.3 * k])
        np.testing.assert_allclose(dancer.joints(), place, atol=4e-6)
        assert (dancer.grid.rate, dancer.skeleton) == (30, SMPL24)


def test_a_file_with_z_up_is_turned_about_the_world(tmp_path: Path) -> None:
    """Pelvises included: SMPL's translation is not the pelvis, which is where the turn is lost most easily."""
    turn = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    content = content_of(DANCE, 2)
    pelvis = SMPL24.offsets[0]
    content["smpl_trans"] = (content["smpl_trans"] + pelvis) @ turn.T - pelvis
    content["smpl_poses"] = content["smpl_poses"].astype(float)
    content["smpl_poses"][:, :, 0] = turn @ content["smpl_poses"][:, :, 0]
    path = write(tmp_path / "a_smpl.pkl", content)
    for up in ("auto", "z"):
        turned = load_motions(path, BOTH, RATE, up)
        np.testing.assert_allclose(turned[1].joints(), DANCE.joints() + np.array([1.2, 0.0, 0.3]), atol=2e-6)
    with raises_message(DataError, "pelvises", where="a_smpl.pkl", reason="bad_axes"):
        load_motions(path, BOTH, RATE, "y")


def test_who_lies_has_no_axis(tmp_path: Path) -> None:
    lying = DANCE.rotations.copy()
    lying[:, 0] = (0.0, 0.0, np.pi / 4)
    path = write(tmp_path / "a_smpl.pkl", content_of(Motion(DANCE.translation, lying, DANCE.grid, SMPL24), 2))
    with raises_message(DataError, "clear", where="a_smpl.pkl", reason="bad_axes"):
        load_motions(path, BOTH, RATE)
    np.testing.assert_allclose(load_motions(path, BOTH, RATE, "y")[0].translation, DANCE.translation, atol=1e-6)


def test_trimmed_frames_are_those_of_the_whole(tmp_path: Path) -> None:
    path = write(tmp_path / "a_smpl.pkl", content_of(DANCE, 2))
    whole, part = load_motions(path, BOTH, RATE)[1], load_motions(path, BOTH, RATE, trim=15)[1]
    np.testing.assert_array_equal(part.rotations, whole.rotations[15:-15])
    np.testing.assert_array_equal(part.translation, whole.translation[15:-15])
    with raises_message(DataError, "trim_frames", where="a_smpl.pkl", reason="empty"):
        load_motions(path, BOTH, RATE, trim=31)


def test_one_dancer_with_nan_leaves_the_others(tmp_path: Path) -> None:
    content = content_of(DANCE, 2)
    content["smpl_trans"][1, 3] = np.nan
    path = write(tmp_path / "a_smpl.pkl", content)
    [motion] = load_motions(path, [0], RATE)
    np.testing.assert_allclose(motion.joints(), DANCE.joints(), atol=2e-6)
    for members in ([1], [2]):
        with raises_message(DataError, "dancer"):
            load_motions(path, members, RATE)


def put(array: np.ndarray, at: Any, value: Any) -> np.ndarray:
    array[at] = value
    return array


BAD: dict[str, tuple[str, Callable[[dict[str, Any]], Any]]] = {
    "rotation vectors": ("bad_shape", replaced("smpl_poses", lambda a: a[..., 0].reshape(*a.shape[:2], 72))),
    "one dancer without an axis of its own": ("bad_shape", replaced("smpl_poses", lambda a: a[0])),
    "translation of fewer dancers": ("bad_shape", replaced("smpl_trans", lambda a: a[:1])),
    "mirrored, determinant -1": (
        "bad_rotation",
        replaced("smpl_poses", lambda a: put(a, (1, 5, 18), np.diag([1, 1, -1]))),
    ),
    "scaled, determinant 1.0013": (
        "bad_rotation",
        replaced("smpl_poses", lambda a: put(a, (0, 5, 4), a[0, 5, 4] * 1.00044)),
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(tmp_path: Path, name: str) -> None:
    reason, change = BAD[name]
    path = write(tmp_path / "a_smpl.pkl", change(content_of(DANCE, 2)))
    with raises_message(DataError, "frames|matrix|smpl_poses|smpl_trans", reason=reason):
        load_motions(path, BOTH, RATE)


def test_build_and_group_windows(source: Path, tmp_path: Path) -> None:
    path = source / "motion" / "seq_001_smpl.pkl"
    content = pickle.loads(path.read_bytes())
    content["smpl_trans"][1, 30] = np.nan
    path.write_bytes(pickle.dumps(content))
    recipe = {
        "recipe": 1, "name": "own", "dataset": {"i-dancers": {"trim_frames": 15}}, "fps": 30,
        "windows": {"length_s": 4, "stride_s": 0.5}, "motion": {"edge151": {}}, "audio": {"librosa35": {}},
    }  # fmt: skip
    dancedata.build(recipe, source, tmp_path / "out", cache=tmp_path / "cache", jobs=1, progress=False)
    with dancedata.open(tmp_path / "out") as store:
        reasons = {r["clip"]: r["reason"] for r in store.rejects}
        assert reasons == {"seq_001_p0": "incomplete_group", "seq_001_p1": "nan"}
        assert {int(clip.n_frames) for clip in store} == {153}
        assert {clip.audio_start for clip in store} == {Fraction(1, 2)}
    sample = GroupDataset(tmp_path / "out", "train", scale=None)[0]
    assert sample["edge151"].shape == (3, 120, 151)
    roots = sample["edge151"][:, :, 4:7]
    np.testing.assert_allclose(np.linalg.norm(roots[1] - roots[0], axis=-1), np.hypot(1.2, 0.3), atol=1e-5)

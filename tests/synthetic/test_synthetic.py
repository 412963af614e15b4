"""The synthetic corpus: its layout, its names and splits, and that what it says about itself is true."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dancedata.core.errors import UsageError
from dancedata.core.grid import WindowGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.synthetic import synthesise_motion, synthesise_song, write_synthetic
from dancedata.synthetic.motion import MotionTruth
from dancedata.synthetic.plan import CATALOGUE, crossmodal_split, make_plan, tempo_bpm
from tests.messages import raises_message

Floats = NDArray[np.float64]
FEET = [SMPL24.index(name) for name in ("left_ankle", "right_ankle", "left_foot", "right_foot")]
PLAN = make_plan(11, 4, 13.5)
CLIPS = [clip.name for clip in PLAN.clips]
# One clip a genre, basic and advanced; all of them take a while.
SOME = CLIPS[::5]


@pytest.fixture(scope="module", params=SOME)
def danced(request: pytest.FixtureRequest) -> tuple[Motion, MotionTruth, Floats]:
    motion, truth = synthesise_motion(request.param)
    return motion, truth, motion.joints()


# --- the plan ---------------------------------------------------------------------------------------------------


def test_default_corpus_has_enough_windows_in_every_split() -> None:
    usable = [clip for clip in PLAN.clips if clip.split and clip.name not in PLAN.ignored]
    windows = {split: 0 for split in ("train", "val", "test")}
    for clip in usable:
        windows[clip.split] += WindowGrid(300, 30).count(clip.n_frames)
    assert sum(windows.values()) >= 700
    assert min(windows.values()) >= 50


def test_train_shares_no_song_with_val_and_test() -> None:
    songs = {s: {c.music for c in PLAN.clips if c.split == s} for s in ("train", "val", "test")}
    assert songs["val"] == songs["test"]
    assert not songs["train"] & songs["test"]


def test_default_corpus_has_the_odd_ones() -> None:
    assert sum(clip.n_frames % 30 == 29 for clip in PLAN.clips) == 1
    assert PLAN.names("")  # in no split
    assert PLAN.ignored
    assert crossmodal_split(PLAN.ignored[0]) == "train"
    assert {clip.name[1:3] for clip in PLAN.clips} == {music[:2] for music in CATALOGUE}
    assert {clip.name.split("_")[1] for clip in PLAN.clips} == {"sBM", "sFM"}
    assert {(song.sample_rate, song.n_channels) for song in PLAN.songs} == {(48_000, 2), (44_100, 1)}


def test_largest_corpus_has_unique_names() -> None:
    plan = make_plan(60, 9, 5.0)
    assert len({clip.name for clip in plan.clips}) == 540
    assert len({song.music for song in plan.songs}) == 60


@pytest.mark.parametrize(("music", "bpm"), [("BR0", 80), ("WA3", 110), ("HO0", 110), ("HO5", 135)])
def test_tempo_by_name(music: str, bpm: float) -> None:
    assert tempo_bpm(music) == bpm


@pytest.mark.parametrize("wrong", [{"songs": 1}, {"songs": 61}, {"clips_per_song": 1}, {"clip_s": 0.5}])
def test_parameters_out_of_range(tmp_path: Path, wrong: dict[str, Any]) -> None:
    with raises_message(UsageError, "synthetic"):
        write_synthetic(tmp_path / "x", **wrong)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("name", ["mXX1", "nonsense", "gBR_sBM_cAll_d04_song_ch01"])
def test_name_without_a_music_id(name: str) -> None:
    with raises_message(UsageError, "mBR0"):
        synthesise_song(name)


# --- the motion -------------------------------------------------------------------------------------------------


def test_feet_are_where_the_truth_says(danced: tuple[Motion, MotionTruth, Floats]) -> None:
    _, truth, joints = danced
    assert np.abs(joints[:, FEET] - truth.foot_positions).max() < 1e-6


def test_planted_feet_stand_and_moving_feet_move(danced: tuple[Motion, MotionTruth, Floats]) -> None:
    _, truth, joints = danced
    feet = joints[:, FEET]
    step = np.linalg.norm(feet[2:] - feet[:-2], axis=2)  # a thirtieth of a second
    standing = truth.planted[:-2] & truth.planted[1:-1] & truth.planted[2:]
    assert step[standing].max() < 1e-9
    assert step[truth.moving[:-2]].min() > 0.019
    assert not (standing & truth.moving[:-2]).any()
    assert (truth.planted.mean(axis=0) > 0.3).all()
    assert (truth.moving.mean(axis=0) > 0.02).all()
    # Ankles and toes differ, or an exchange of columns would go unseen.
    assert (truth.planted[:, :2] != truth.planted[:, 2:]).any(axis=0).all()


def test_nobody_sinks_into_the_floor(danced: tuple[Motion, MotionTruth, Floats]) -> None:
    _, truth, joints = danced
    assert 0.52 <= truth.floor_height_m <= 0.66
    assert joints[..., 1].min() > truth.floor_height_m - 0.002
    toes_down = truth.planted[:, 2:]
    assert np.abs(joints[:, FEET[2:], 1][toes_down] - truth.floor_height_m).max() < 1e-6


def test_body_moves_like_a_body(danced: tuple[Motion, MotionTruth, Floats]) -> None:
    motion, truth, joints = danced
    turns = Rotation.from_rotvec(np.array(motion.rotations.reshape(-1, 3)))
    matrices = turns.as_matrix().reshape(-1, 24, 3, 3)
    relative = np.swapaxes(matrices[:-1], -1, -2) @ matrices[1:]
    angle = Rotation.from_matrix(relative.reshape(-1, 3, 3)).magnitude()
    assert np.rad2deg(angle.max()) * 60 < 1500  # a flag is raised at 2,700
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=2) * 60
    assert speed.max() < 14
    assert 0.2 < speed.mean() < 1.5
    pelvis = joints[:, 0, 1] - truth.floor_height_m
    assert pelvis.min() > 0.7
    assert pelvis.max() < 1.15
    apart = np.linalg.norm((joints[:, FEET[0]] - joints[:, FEET[1]])[:, [0, 2]], axis=1)
    assert apart.min() > 0.1
    assert apart.max() < 0.6


def test_key_poses_are_velocity_minima_on_beats(danced: tuple[Motion, MotionTruth, Floats]) -> None:
    _, truth, joints = danced
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=2).mean(axis=1) * 60
    keys = truth.key_frames[(truth.key_frames > 10) & (truth.key_frames < len(speed) - 10)]
    assert len(keys) >= 8
    assert set(keys) <= set(truth.beat_frames)
    assert np.abs(truth.beat_frames / 60 - truth.beat_times_s).max() <= 0.5 / 60 + 1e-9
    assert speed[keys].max() < 0.1 * speed.mean()
    for key in keys:
        near = speed[key - 8 : key + 8]
        assert abs(int(near.argmin()) - 8) <= 2


def test_corpus_has_wraps_and_turns() -> None:
    motions = {name: synthesise_motion(name)[0] for name in SOME}
    longest = {name: np.linalg.norm(m.rotations, axis=2).max() for name, m in motions.items()}
    assert sum(length > np.pi for length in longest.values()) >= 3
    assert max(longest.values()) < 2 * np.pi
    facing = []
    for motion in motions.values():
        ahead = Rotation.from_rotvec(np.array(motion.rotations[:, 0])).apply([0.0, 0.0, 1.0])
        facing.append(np.ptp(np.unwrap(np.arctan2(ahead[:, 0], ahead[:, 2]))))
    assert max(facing) > np.pi


@pytest.mark.parametrize("n_frames", [1, 2, 37, 360])
def test_any_length(n_frames: int) -> None:
    motion, truth = synthesise_motion(CLIPS[0], n_frames=n_frames)
    assert motion.n_frames == len(truth.planted) == len(truth.moving) == n_frames
    assert (truth.key_frames < n_frames).all()
    assert (truth.beat_frames < n_frames).all()


# --- the music --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("music", ["mBR0", "mHO3", "mKR5", "mJB2"])
def test_librosa_finds_tempo_and_beats(music: str) -> None:
    librosa = pytest.importorskip("librosa")
    song = synthesise_song(music)
    y = librosa.resample(song.signal.samples, orig_sr=song.signal.sample_rate, target_sr=15_360)
    envelope = librosa.onset.onset_strength(y=y, sr=15_360)
    tempo, frames = librosa.beat.beat_track(
        onset_envelope=envelope, sr=15_360, hop_length=512, start_bpm=song.tempo_bpm, tightness=100
    )
    assert float(np.ravel(tempo)[0]) == pytest.approx(song.tempo_bpm, rel=0.05)
    found = frames / 30
    near = np.abs(found[None] - song.beat_times_s[:, None]).min(axis=1) < 0.07
    assert near.mean() > 0.8


def test_song_is_music() -> None:
    song = synthesise_song("mLO2", seed=3, length_s=12.0)
    assert song.pcm.shape == (576_000, 2)
    assert np.abs(song.pcm.astype(int)).max() > 20_000
    assert not np.array_equal(song.pcm[:, 0], song.pcm[:, 1])
    assert len(set(song.chord_roots[:4])) >= 3
    np.testing.assert_allclose(np.diff(song.beat_times_s), 0.6)
    np.testing.assert_allclose(song.signal.samples, song.pcm.mean(axis=1) / 32768, atol=1e-7)

"""The synthetic corpus: names and splits, that what it says about itself is true, its folder, its reader."""

import hashlib
import inspect
import json
import wave
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dancedata.core.clip import ClipRef
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.synthetic import Synthetic
from dancedata.formats.safe_pickle import load_pickle
from dancedata.synthetic import corpus as synthetic
from dancedata.synthetic import motion, music, synthesise_motion, synthesise_song, write_synthetic
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
    for turned in motions.values():
        ahead = Rotation.from_rotvec(np.array(turned.rotations[:, 0])).apply([0.0, 0.0, 1.0])
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


# ---- the folder, and the plug-in that reads it


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synthetic(tmp_path_factory.mktemp("a") / "corpus", songs=3, clips_per_song=2, clip_s=6.0)


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def test_layout(corpus: Path) -> None:
    plan = make_plan(3, 2, 6.0)
    names = {clip.name for clip in plan.clips}
    assert {path.stem for path in (corpus / "motions").glob("*.pkl")} == names
    assert {path.stem for path in (corpus / "wavs").glob("*.wav")} == {f"m{s.music}" for s in plan.songs}
    mapping = (corpus / "cameras" / "mapping.txt").read_text().splitlines()
    assert {line.split()[0] for line in mapping} == names
    for split in ("train", "val", "test"):
        listed = (corpus / "splits" / f"crossmodal_{split}.txt").read_text().split()
        assert listed
        assert listed == [name for name in sorted(names) if crossmodal_split(name) == split]
    for name in (*names, *(f"m{song.music}" for song in plan.songs)):
        assert (corpus / "truth" / f"{name}.npz").is_file()


def test_pickles_hold_the_synthesised_motion(corpus: Path) -> None:
    for clip in make_plan(3, 2, 6.0).clips:
        content = load_pickle(corpus / "motions" / f"{clip.name}.pkl")
        assert isinstance(content, dict)
        motion, truth = synthesise_motion(clip.name, n_frames=clip.n_frames)
        assert content["smpl_poses"].shape == (clip.n_frames, 72)
        assert {content[key].dtype for key in content if key != "smpl_loss"} == {np.dtype("float32")}
        assert 89 <= content["smpl_scaling"][0] <= 99
        metres = content["smpl_trans"] / content["smpl_scaling"]
        np.testing.assert_allclose(metres, motion.translation, atol=1e-6)
        np.testing.assert_allclose(content["smpl_poses"].reshape(-1, 24, 3), motion.rotations, atol=1e-6)
        stored = np.load(corpus / "truth" / f"{clip.name}.npz")
        np.testing.assert_array_equal(stored["planted"], truth.planted)
        np.testing.assert_array_equal(stored["key_frames"], truth.key_frames)


def test_float32_does_not_unplant_the_feet(corpus: Path) -> None:
    name = make_plan(3, 2, 6.0).clips[0].name
    motion = Synthetic(songs=3, clips_per_song=2, clip_s=6.0).load(_ref(corpus, name))
    feet = motion.joints()[:, FEET]
    planted = np.load(corpus / "truth" / f"{name}.npz")["planted"]
    step = np.linalg.norm(np.diff(feet, axis=0), axis=2)
    assert step[planted[1:] & planted[:-1]].max() < 1e-5


def _ref(corpus: Path, name: str) -> ClipRef:
    scan = Synthetic(songs=3, clips_per_song=2, clip_s=6.0).scan(corpus)
    return next(ref for ref in scan.clips if ref.id == name)


def test_wavs_are_pcm_longer_than_the_motion(corpus: Path) -> None:
    shapes = {}
    for path in sorted((corpus / "wavs").glob("*.wav")):
        with wave.open(str(path)) as file:
            assert file.getsampwidth() == 2
            assert file.getnframes() / file.getframerate() > 6.0
            shapes[path.stem] = (file.getframerate(), file.getnchannels())
    assert shapes == {"mBR0": (48_000, 2), "mHO3": (44_100, 1), "mPO4": (48_000, 2)}


def test_same_seed_same_bytes_and_clips_do_not_depend_on_one_another(corpus, tmp_path, monkeypatch):
    # Generated each time, not kept as in other tests.
    monkeypatch.setattr(music, "make_song", inspect.unwrap(music.make_song))
    monkeypatch.setattr(motion, "make_motion", inspect.unwrap(motion.make_motion))
    before = digests(corpus)
    assert digests(write_synthetic(tmp_path / "again", songs=3, clips_per_song=2, clip_s=6.0)) == before
    more = digests(write_synthetic(tmp_path / "more", songs=4, clips_per_song=2, clip_s=6.0))
    # The clip with 29 (mod 30) frames is another one there; the rest is the same.
    same = [name for name in before if name.startswith(("motions", "wavs")) and more[name] == before[name]]
    assert len(same) >= 8
    other = digests(write_synthetic(tmp_path / "other", songs=3, clips_per_song=2, clip_s=6.0, seed=1))
    assert not any(before[name] == other[name] for name in before if name.startswith(("motions", "wavs")))


def test_a_second_call_writes_nothing(corpus: Path) -> None:
    times = {path: path.stat().st_mtime_ns for path in corpus.rglob("*")}
    write_synthetic(corpus, songs=3, clips_per_song=2, clip_s=6.0)
    assert {path: path.stat().st_mtime_ns for path in corpus.rglob("*")} == times


def test_other_parameters_are_an_error_that_shows_them(corpus: Path) -> None:
    before = digests(corpus)
    with raises_message(SourceError, "clips_per_song", where="corpus/synthetic.json"):
        write_synthetic(corpus, songs=3, clips_per_song=2, clip_s=6.0, seed=7)
    assert digests(corpus) == before


@pytest.mark.parametrize(("file", "source", "word", "where"), [
    ("thesis.txt", ".", "separate", ""), (synthetic.MARKER, ".", "clips_per_song", "synthetic.json"),
    ("file", "file", "synthetic", "file"), ("file", "file/below", "enough", "file/below"),
])  # fmt: skip
def test_sources_that_cannot_be_written(tmp_path: Path, file: str, source: str, word: str, where: str) -> None:
    (tmp_path / file).write_text("{")
    for make in (write_synthetic, Synthetic().scan):
        with raises_message(SourceError, word, where=where):
            make(tmp_path / source)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(file, "{")]


def test_an_interrupted_write_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "corpus"
    size: dict[str, Any] = {"songs": 2, "clips_per_song": 2, "clip_s": 3.0}
    with monkeypatch.context() as patch:
        patch.setattr(synthetic, "_write_clip", _interrupt)
        with pytest.raises(KeyboardInterrupt):
            write_synthetic(folder, **size)
    assert not (folder / synthetic.MARKER).exists()
    write_synthetic(folder, **size)
    assert json.loads((folder / synthetic.MARKER).read_text())["songs"] == 2
    assert digests(folder) == digests(write_synthetic(tmp_path / "whole", **size))


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


# --- the plug-in ------------------------------------------------------------------------------------------------


def test_scan_writes_and_lists(tmp_path: Path) -> None:
    dataset = Synthetic(songs=2, clips_per_song=2, clip_s=3.0)
    scan = dataset.scan(tmp_path / "new")
    assert [ref.id for ref in scan.clips] == [clip.name for clip in make_plan(2, 2, 3.0).clips]
    assert not scan.rejects
    for ref in scan.clips:
        assert ref.split == crossmodal_split(ref.id)
        assert ref.audio_path is not None
        assert ref.audio_path.is_file()
        assert ref.tempo_bpm == tempo_bpm(ref.music.removeprefix("m"))
        assert dataset.load(ref).n_frames in (179, 180)


def test_example_covers_the_splits(tmp_path: Path) -> None:
    Synthetic().make_example(tmp_path / "example")
    scan = Synthetic().scan(tmp_path / "example")
    assert {ref.split for ref in scan.clips} == {"train", "val", "test"}
    assert any("example" in note for note in scan.notes)
    with raises_message(SourceError, "clips_per_song", where="example/synthetic.json"):
        Synthetic(seed=1).scan(tmp_path / "example")
    with raises_message(SourceError, "clips_per_song", where="example/synthetic.json"):
        write_synthetic(tmp_path / "example")  # it requires the whole corpus

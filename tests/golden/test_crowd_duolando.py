"""Rotations, windows and scores of Duolando's own code on made-up duets."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.rotations import matrix_from_rotvec
from dancedata.datasets.dd100 import DD100
from dancedata.formats.motion_files import smplx_arrays
from dancedata.metrics import (
    beat_alignment,
    beat_echo,
    contact_spans,
    diversity,
    duet_distances,
    frechet,
    geometric,
    motion_beats,
    skating,
)
from dancedata.metrics.kinetic_features import KINETIC_VARIANTS
from dancedata.metrics.set_statistics import STATISTICS
from dancedata.torch import GroupDataset, Windows
from tests.golden.conftest import load

DUETS = ("Waltz_5_0", "Waltz_6_0", "Ballet_9_0", "Qiaqiaqia_12_1")
ENDS = [0, 1, -2, -1]


@pytest.fixture(scope="module")
def facts(crowd: Path) -> Any:
    return json.loads((crowd / "duolando" / "facts.json").read_text())


@pytest.fixture(scope="module")
def scores(crowd: Path) -> Any:
    return json.loads((crowd / "duolando" / "metrics.json").read_text())


@pytest.fixture(scope="module")
def motions(crowd: Path) -> dict[str, Any]:
    return {clip.id: DD100().load(clip) for clip in DD100().scan(crowd / "inputs" / "dd100").clips}


@pytest.fixture(scope="module")
def joints(motions: dict[str, Any]) -> dict[str, np.ndarray]:
    """SMPL-X's joints (T, 55, 3) with +Z up, as Duolando's files have them."""
    y_up = {name: motion.joints() for name, motion in motions.items()}
    return {name: np.stack([p[..., 0], -p[..., 2], p[..., 1]], axis=-1) for name, p in y_up.items()}


@pytest.fixture(scope="module")
def store(crowd: Path, facts: Any, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The duets in windows of 48 frames every 8, with as many rows of music as Duolando's features have."""
    folder = tmp_path_factory.mktemp("duolando")
    source = shutil.copytree(crowd / "inputs" / "dd100", folder / "source")
    (source / "rows").mkdir()
    for duet, n in facts["music_rows"].items():
        np.save(source / "rows" / f"{duet}.npy", np.arange(n, dtype=np.float32)[:, None])
    recipe = {
        "recipe": 1, "name": "duets", "dataset": {"dd100": {}},
        "windows": {"length_frames": 48, "stride_frames": 8},
        "motion": {"joints": {"body": "smplx55"}, "finedance319": {}},
        "audio": {"file": {"path": "rows/{group}.npy", "rate": 30, "columns_per_row": 1, "tolerance_s": 1}},
    }  # fmt: skip
    dancedata.build(recipe, source, folder / "store", jobs=1, cache=cache, progress=False)
    return folder / "store"


def test_rotation_matrices(crowd: Path, motions: dict[str, Any]) -> None:
    golden = load(crowd / "duolando" / "dd100.npz")
    keys = [key for key in golden if "rotmat_first_last" in key]
    assert keys
    for key in keys:
        arrays = smplx_arrays(motions[key.split(".")[0]])
        matrices = matrix_from_rotvec(arrays["poses"].reshape(-1, 55, 3)).reshape(-1, 495)
        rows = np.concatenate([arrays["trans"], matrices], axis=1)[ENDS]
        np.testing.assert_allclose(rows, golden[key], rtol=0, atol=1e-5)


def test_the_split_and_the_hold(facts: Any, crowd: Path, joints: dict[str, np.ndarray]) -> None:
    clips = DD100().scan(crowd / "inputs" / "dd100").clips
    for part, of_part in facts["split"].items():
        assert {f"{clip.id}.npy" for clip in clips if clip.split == part} == set(of_part["motion"])
        assert {clip.music for clip in clips if clip.split == part} == set(of_part["music"])
    for duet, (start, end) in facts["hold_frames_follower_right_wrist_to_leader_left_wrist_3cm"].items():
        spans = contact_spans(joints[f"{duet}_00"], joints[f"{duet}_01"], within_m=0.0301)
        (hold,) = [span for span in spans if (span.joint, span.other_joint) == (21, 20)]
        assert (hold.start, hold.end) in {(start, end), (start, end + 1)}


@pytest.mark.parametrize("key", ["L48_m8", "L64_m4", "whole_m8"])
@pytest.mark.parametrize("split", ["train", "test"])
def test_windows(facts: Any, store: Path, key: str, split: str) -> None:
    wanted = facts["windows"][f"{key}.{split}"]
    assert wanted["music_lengths"] == wanted["lengths"]
    if key == "whole_m8":  # both dancers have the frames of the shorter one, here to a multiple of 8
        clips = [clip for clip in dancedata.open(store).clips() if clip.split == split and clip.role == "follower"]
        found = sorted((clip.group, clip.n_frames // 8 * 8) for clip in clips)
        assert found == list(zip(wanted["names"], wanted["lengths"], strict=True))
        return
    length, stride = int(key[1:3]), int(key[-1])
    dataset = GroupDataset(store, split, windows=Windows(length=length, stride=stride), scale=None)
    assert sorted(window.clip.rsplit("_", 1)[0] for window in dataset.windows) == wanted["names"]
    assert set(wanted["lengths"]) == {length}
    np.testing.assert_array_equal(dataset[1]["file"][:, 0], dataset.windows[1].start + np.arange(length))


@pytest.mark.parametrize("split", ["train", "test"])
def test_first_and_last_window(crowd: Path, facts: Any, store: Path, split: str) -> None:
    """Joints relative to the pelvis, fingers relative to their wrist and times 10, as Duolando's loader has them."""
    golden = load(crowd / "duolando" / "dd100.npz")
    dataset = GroupDataset(store, split, scale=None)
    places = sorted(range(len(dataset)), key=lambda k: (dataset.windows[k].clip, dataset.windows[k].start))
    first, last = dataset[places[0]], dataset[places[-1]]
    assert first["roles"] == ["follower", "leader"]
    follower, leader = (relative(rows.numpy()) for rows in first["joints"])
    # Times 10 are the errors of fingers, too.
    np.testing.assert_allclose(leader, golden[f"window.{split}.pos3dl"], rtol=0, atol=1e-4)
    np.testing.assert_allclose(leader[:, :75], golden[f"window.{split}.pos3dl"][:, :75], rtol=0, atol=1e-5)
    np.testing.assert_allclose(follower[0], golden[f"window.{split}.pos3df_row0"], rtol=0, atol=1e-4)
    row = relative(last["joints"][0].numpy())[0]
    np.testing.assert_allclose(row, golden[f"lastwindow.{split}.pos3df_row0"], rtol=0, atol=1e-4)
    motion = dancedata.decode(first["finedance319"][0].numpy(), "finedance319", fps=30)
    matrices = matrix_from_rotvec(smplx_arrays(motion)["poses"].reshape(-1, 55, 3))
    rotations = golden[f"window.{split}.rotmatf_row0"]
    np.testing.assert_allclose(matrices[0].reshape(-1), rotations, rtol=0, atol=1e-5)
    start = dataset.windows[places[-1]].start
    assert last["file"][0, 0] == start
    music = golden[f"{facts['split'][split]['music'][-1]}.music54"]  # compared in tests/audio
    np.testing.assert_array_equal(music[start], golden[f"lastwindow.{split}.music_row0"])


def relative(y_up: np.ndarray) -> np.ndarray:
    """Duolando's input (T, 165) of positions (T, 165) with +Y up."""
    joints = y_up.reshape(len(y_up), 55, 3)[..., [0, 2, 1]] * (1, -1, 1)
    out = joints - joints[:, :1]
    out[:, 0] = joints[:, 0]
    for wrist, fingers in ((20, slice(25, 40)), (21, slice(40, 55))):
        out[:, fingers] = (joints[:, fingers] - joints[:, wrist : wrist + 1]) * 10
    return out.reshape(len(y_up), 165)


# ---- scores


@pytest.mark.parametrize("duet", DUETS)
def test_scores_of_a_duet(crowd: Path, scores: Any, joints: dict[str, np.ndarray], duet: str) -> None:
    golden, wanted = load(crowd / "duolando" / "metrics.npz"), scores[duet]
    follower, leader = joints[f"{duet}_00"], joints[f"{duet}_01"]
    np.testing.assert_allclose(duet_distances(follower, leader), golden[f"{duet}.duet100"], rtol=1e-4)
    beats = [motion_beats(dancer, 30, detector="bailando") for dancer in (follower, leader)]
    assert [b.tolist() for b in beats] == [wanted["beats_follower"], wanted["beats_leader"]]
    assert [len(follower) - 1, len(leader) - 1] == wanted["curve_lengths"]
    assert beat_echo(leader, follower, 30, detector="bailando") == pytest.approx(wanted["BED"], rel=1e-9)
    bas = beat_alignment(wanted["music_beats"], beats[0], sigma=3)
    assert bas == pytest.approx(wanted["BAS_follower"], rel=1e-9)
    # Fingers as two joints, positions from the first pelvis, and y as up: the program's slip, as DD100 has z up.
    hands = [follower[:, first : first + 15 : 3].mean(axis=1, keepdims=True) for first in (25, 40)]
    body = np.concatenate([follower[:, :22], *hands], axis=1) - follower[:1, :1]
    kinetic = KINETIC_VARIANTS["code"](body, 30)
    np.testing.assert_allclose(kinetic, golden[f"{duet}.kinetic72_follower"], rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(geometric(body), golden[f"{duet}.manual32_follower"], rtol=1e-4, atol=1e-7)
    found = skating(follower, 30, rule="duolando", up="z")
    assert [found.sliding[0], found.counted[0]] == wanted["footskating_follower"]


def test_means_and_the_frechet_distance_of_two_tables(crowd: Path, scores: Any) -> None:
    golden, wanted = load(crowd / "duolando" / "metrics.npz"), scores["fid_given"]
    assert np.mean([scores[duet]["BED"] for duet in DUETS]) == pytest.approx(scores["BED_mean"])
    real, made = STATISTICS["numpy"](golden["fid_gt"], golden["fid_pred"])
    assert frechet(real, made) == pytest.approx(wanted["fid"], rel=1e-4)
    assert diversity(made) == pytest.approx(wanted["div_pred"], rel=1e-4)
    assert diversity(real) == pytest.approx(wanted["div_gt"], rel=1e-4)

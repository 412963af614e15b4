"""The export duolando: joints, rotation matrices and music of duets, as Duolando's scripts make them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.spatial.transform import Rotation

import dancedata
from dancedata.audio.bailando54 import Bailando54
from dancedata.core.errors import StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import DATASETS
from dancedata.music.signal import load_audio
from dancedata.store import write_store
from dancedata.store.schema import Field
from dancedata.store.stored_clip import AudioBlock
from dancedata.testing.stores import random_columns
from tests.groups_store import HEADER, stored
from tests.messages import raises_message

Arrays = dict[str, np.ndarray]
RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "duets", "dataset": {"dd100": {}}, "windows": {"length_frames": 4, "stride_frames": 1},
    "motion": {"finedance319": {}}, "audio": {"bailando54": {}},
}  # fmt: skip
#: Of Duolando's rule, test and train.
PAIRS = {"Waltz_5_0": "test", "Waltz_6_0": "train"}


@pytest.fixture(scope="module")
def golden(crowd_golden: Any) -> Arrays:
    """Some frames of a made-up duet as files of DD100 have them, and what Duolando's scripts made of these."""
    return {**crowd_golden("groups"), **crowd_golden("duet")}


@pytest.fixture(scope="module")
def source(golden: Arrays, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """These frames, twice, to half a second of noise."""
    folder = tmp_path_factory.mktemp("duolando") / "source"
    motions, songs = folder / "motion" / "smplx" / "all", folder / "music" / "mp3" / "all"
    for place in (motions, songs):
        place.mkdir(parents=True)
    for pair in PAIRS:
        for member in (0, 1):
            poses = golden[f"{member}.poses"]
            cell = np.empty((), object)
            cell[()] = {"poses": poses, "global_orient": poses[:, :3], "transl": golden[f"{member}.transl"]}
            np.save(motions / f"{pair}_0{member}.npy", cell, allow_pickle=True)
        noise = np.random.default_rng(len(pair)).normal(scale=0.1, size=15360 // 2)
        soundfile.write(songs / f"{pair}.wav", noise, 15360)
    return folder


@pytest.fixture(scope="module")
def out(source: Path, cache: Path) -> Path:
    store = source.parent / "store"
    dancedata.build(RECIPE, source, store, jobs=1, cache=cache, progress=False)
    return dancedata.export(store, "duolando", source.parent / "out", progress=False).path


def test_the_loaders_folders(out: Path) -> None:
    files = {path.relative_to(out).as_posix() for path in out.rglob("*.npy")}
    expected = {f"music/feature/{split}/{pair}.npy" for pair, split in PAIRS.items()}
    for kind in ("pos3d", "rotmat"):
        expected |= {f"motion/{kind}/{split}/{pair}_0{k}.npy" for pair, split in PAIRS.items() for k in (0, 1)}
    assert files == expected


@pytest.mark.parametrize("pair", PAIRS)
def test_joints_and_rotations_are_duolandos(golden: Arrays, out: Path, pair: str) -> None:
    n = len(golden["index"])
    for member, role in enumerate(("follower", "leader")):
        joints, rotmat = (
            np.load(out / "motion" / kind / PAIRS[pair] / f"{pair}_0{member}.npy") for kind in ("pos3d", "rotmat")
        )
        assert (joints.dtype, joints.shape, rotmat.dtype, rotmat.shape) == ("f4", (n, 165), "f4", (n, 498))
        wanted = golden[role][golden["index"]].reshape(n, 165)
        np.testing.assert_allclose(joints, wanted, rtol=0, atol=1e-5)
        ends = golden[f"{member}.rotmat_first_last"]
        np.testing.assert_allclose(rotmat[:2], ends[:2], rtol=0, atol=1e-5)
        if role == "leader":  # the follower's last frames come after those of the leader
            np.testing.assert_allclose(rotmat[-2:], ends[-2:], rtol=0, atol=1e-5)
        rotations = Rotation.from_rotvec(golden[f"{member}.poses"].reshape(-1, 3)).as_matrix().reshape(n, -1)
        np.testing.assert_allclose(rotmat[:, 3:], rotations, rtol=0, atol=1e-5)
        np.testing.assert_allclose(rotmat[:, :3], golden[f"{member}.transl"], rtol=0, atol=1e-5)


def test_music_has_the_rows_of_the_motion(golden: Arrays, source: Path, out: Path) -> None:
    for pair, split in PAIRS.items():
        rows = np.load(out / "music" / "feature" / split / f"{pair}.npy")
        song = load_audio(source / "music" / "mp3" / "all" / f"{pair}.wav")
        assert (rows.dtype, rows.shape) == ("f4", (len(golden["index"]), 54))
        np.testing.assert_allclose(rows, Bailando54().extract(song, FrameGrid.of(30))[: len(rows)], atol=1e-4)


def write_duets(out: Path, group: str = "") -> None:
    """A store of groups of two, three and one dancer without fingers or roles."""
    clips = []
    for clip in stored({"train": (2, 3), "test": (2,)}):
        rows = np.full((clip.n_frames, 54), 0.5, np.float32)
        name, id = (clip.group and f"{group}{clip.group}"), f"{group}{clip.id}"
        clips.append(replace(clip, id=id, group=name, audio={"rows54": (AudioBlock(name or id, rows),)}))
    field = Field("rows54", "audio", random_columns(54, mirror=False), HEADER.fps)
    out.mkdir()
    write_store(out, replace(HEADER, fields=(*HEADER.fields[:2], field)), clips)


def test_groups_of_two_without_roles_or_fingers(tmp_path: Path) -> None:
    write_duets(tmp_path / "store")
    done = dancedata.export(tmp_path / "store", "duolando", tmp_path / "out", progress=False, feature="rows54")
    names = sorted(path.name for path in (done.path / "motion" / "pos3d").rglob("*.npy"))
    assert names == ["test0_00.npy", "test0_01.npy", "train0_00.npy", "train0_01.npy"]
    assert done.notes == (
        "the motion field has no fingers: hands are at rest",
        "the dataset has no followers: the first member of each pair is the follower",
        "4 dancers outside pairs are not in the export: Duolando reads duets",
    )
    y_up = dancedata.open(tmp_path / "store")["train0_p1"].read("joints")
    joints = np.load(done.path / "motion" / "pos3d" / "train" / "train0_01.npy")
    np.testing.assert_allclose(joints[:, :3], y_up[:, [0, 2, 1]] * (1, -1, 1), atol=1e-5)


def test_what_is_missing_is_named(tmp_path: Path, cache: Path) -> None:
    source = tmp_path / "source"
    DATASETS.get("synthetic")().make_example(source)
    recipe = RECIPE | {"dataset": {"synthetic": {}}, "motion": {"joints": {}}, "audio": {"librosa35": {}}}
    dancedata.build(recipe, source, tmp_path / "store", jobs=1, cache=cache, progress=False)
    with raises_message(StoreError, "bailando54", where="store"):
        dancedata.export(tmp_path / "store", "duolando", tmp_path / "out", progress=False)


def test_names_that_the_loader_changes_are_refused(tmp_path: Path) -> None:
    """It takes the path of rotation matrices from that of joints, with every pos3d replaced."""
    write_duets(tmp_path / "store", "pos3d-")
    with raises_message(StoreError, "pos3d-train0_p1", where="store"):
        dancedata.export(tmp_path / "store", "duolando", tmp_path / "out", progress=False, feature="rows54")

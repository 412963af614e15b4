"""The exports of groups: gcd gives AIOZ-GDANCE's files back, tcdiff slices and their sound, duolando duets."""

import pickle
import shutil
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
from dancedata.core.registry import DATASETS, FEATURES
from dancedata.exports.gcd import sequence_name
from dancedata.music.signal import load_audio
from dancedata.store import write_store
from dancedata.store.schema import Field
from dancedata.store.stored_clip import AudioBlock
from dancedata.testing.stores import random_columns
from tests.groups_store import HEADER, stored
from tests.messages import raises_message

pytestmark = pytest.mark.usefixtures("quick_bailando438")


def build(tmp_path: Path, cache: Path, dataset: str, motion: str) -> Path:
    source = tmp_path / "source"
    if not source.exists():
        DATASETS.get(dataset)().make_example(source)
    recipe: dict[str, Any] = {
        "recipe": 1, "name": dataset, "dataset": {dataset: {}}, "windows": {"length_s": 2, "stride_s": 1},
        "motion": {motion: {}}, "audio": {"librosa35": {}},
    }  # fmt: skip
    dancedata.build(recipe, source, tmp_path / "store", jobs=1, cache=cache, progress=False)
    return tmp_path / "store"


@pytest.mark.parametrize("motion", ["edge151", "gcd151"])
def test_the_files_of_the_source_come_back(tmp_path: Path, cache: Path, motion: str) -> None:
    store = build(tmp_path, cache, "aioz-gdance", motion)
    out = tmp_path / "out"
    dancedata.export(store, "gcd", out=out)
    sources = {path.name: path for path in (tmp_path / "source" / "motions_smpl").iterdir()}
    written = sorted((out / "motions_smpl").iterdir())
    assert {path.name for path in written} == set(sources)
    for path in written:
        ours, theirs = pickle.loads(path.read_bytes()), pickle.loads(sources[path.name].read_bytes())
        np.testing.assert_allclose(ours["root_trans"], theirs["root_trans"], atol=1e-6)
        poses = theirs["smpl_poses"]
        if "smpl_orients" in theirs:
            hands = np.zeros((*poses.shape[:2], 72 - 3 - poses.shape[2]))
            poses = np.concatenate([theirs["smpl_orients"], poses, hands], axis=2)
        assert ours["smpl_poses"].shape == poses.shape
        # Vectors of one rotation may differ by whole turns.
        one, two = (Rotation.from_rotvec(p.reshape(-1, 3)).as_matrix() for p in (ours["smpl_poses"], poses))
        np.testing.assert_allclose(one, two, atol=2e-6)
        assert ours["meta"].keys() == {"orig_start", "orig_end"}
        music = np.load(out / "jukebox_features" / f"{path.stem}.npy")
        assert music.shape == (poses.shape[1], 35)
    names = (out / "split_sequence_names.txt").read_text().split()
    assert names == sorted(path.stem for path in written)
    lists = [(out / f"{split}_split_sequence_names.txt").read_text().split() for split in ("train", "val", "test")]
    assert sorted(name for of_split in lists for name in of_split) == names


def test_a_dataset_without_groups_is_refused(tmp_path: Path, cache: Path) -> None:
    store = build(tmp_path, cache, "synthetic", "edge151")
    with raises_message(StoreError, "groups", where="store"):
        dancedata.export(store, "gcd", out=tmp_path / "out")


@pytest.mark.parametrize(
    ("group", "frames", "name"),
    [
        ("-Ab_cdEf123_02_187_367", 180, "-Ab_cdEf123_02_187_367"),
        ("-Ab_cdEf123_02_187_367", 140, "-Ab_cdEf123_02_187_327"),
        ("Ballet_9_0", 200, "Ballet_9_0_00_0_200"),
        ("x", 90, "x_00_0_90"),
    ],
)
def test_names_state_the_frames(group: str, frames: int, name: str) -> None:
    assert sequence_name(group, frames)[0] == name


def test_motion_ends_with_its_music(tmp_path: Path, cache: Path) -> None:
    """The name promises frames, and GCD takes as many rows of music as of motion."""
    source = tmp_path / "source"
    DATASETS.get("aioz-gdance")().make_example(source)
    wav = source / "musics" / "-Ab_cdEf123_01_0_180.wav"
    samples, rate = soundfile.read(wav)
    soundfile.write(wav, samples[: 4 * rate], rate)
    dancedata.export(build(tmp_path, cache, "aioz-gdance", "edge151"), "gcd", out=tmp_path / "out")
    for path in (tmp_path / "out" / "motions_smpl").iterdir():
        rows = np.load(tmp_path / "out" / "jukebox_features" / f"{path.stem}.npy")
        start, end = map(int, path.stem.rsplit("_", 2)[1:])
        assert len(rows) == end - start == pickle.loads(path.read_bytes())["root_trans"].shape[1]


RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "groups", "dataset": {"aioz-gdance": {}}, "windows": {"length_s": 5, "stride_s": 0.5},
    "motion": {"edge151": {}}, "audio": {"bailando438": {"fps": 60}},
}  # fmt: skip
DUET, FIVE = "-Ab_cdEf123_01_0_180", "Zz9_8-7_6Q1_02_300_481"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tcdiff") / "source"
    DATASETS.get("aioz-gdance")().make_example(folder)
    for path in [*(folder / "motions_smpl").iterdir(), *(folder / "musics").iterdir()]:
        if path.stem not in (DUET, FIVE):
            path.unlink()
    return folder


@pytest.fixture(scope="module")
def built(source: Path) -> Path:
    out = source.parent / "store"
    dancedata.build(RECIPE, source, out, jobs=1, cache=source.parent / "cache", progress=False)
    return out


@pytest.fixture(scope="module")
def out(source: Path, built: Path) -> Path:
    """With the song's rows, which are computed once."""
    out = source.parent / "out"
    dancedata.export(built, "tcdiff", out=out, source=source, feature="bailando438")
    return out


def slices(out: Path, part: str, name: str, ending: str) -> list[Path]:
    paths = list((out / part / name).iterdir())
    assert {path.suffix for path in paths} == {ending}
    return sorted(paths)


def test_slices_are_those_of_the_source(source: Path, out: Path) -> None:
    motion = {part: slices(out, part, "motions_sliced", ".pkl") for part in ("train", "test")}
    # 180 or 181 frames have three windows of 150 every 15; TCDiff's test is the val list.
    assert [path.stem for path in motion["test"]] == [f"{FIVE}_slice{k}" for k in range(3)]
    assert [path.stem for path in motion["train"]] == [f"{DUET}_slice{k}" for k in range(3)]
    for path in [*motion["train"], *motion["test"]]:
        group, number = path.stem.rsplit("_slice", 1)
        first = 15 * int(number)
        whole = pickle.loads((source / "motions_smpl" / f"{group}.pkl").read_bytes())
        content = pickle.loads(path.read_bytes())
        np.testing.assert_allclose(content["pos"], whole["root_trans"][:, first : first + 150], atol=1e-6)
        assert content["q"].shape == (*content["pos"].shape[:2], 72)
        song, rate = soundfile.read(source / "musics" / f"{group}.wav", always_2d=True)
        part = path.parent.parent
        cut, _ = soundfile.read(part / "wavs_sliced" / f"{path.stem}.wav")
        begin = int(number) * (rate // 2)
        np.testing.assert_allclose(cut, song.mean(axis=1)[begin : begin + 5 * rate], atol=2**-14)
    lists = {n: (out / f"split_dancerNum_{n}.txt").read_text().split() for n in range(2, 8)}
    assert lists == {2: [DUET], 3: [], 4: [], 5: [FIVE], 6: [], 7: []}


def test_columns_of_the_song(built: Path, out: Path) -> None:
    stored = np.load(out / "train" / "feats438" / f"{DUET}_slice1.npy")
    with dancedata.open(built) as store:
        np.testing.assert_array_equal(stored, store[f"{DUET}_p0"].read("bailando438")[30:330])


def test_windows_end_with_the_music_and_have_columns_of_their_own(source: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(source, copy)
    for wav in (copy / "musics").iterdir():
        samples, rate = soundfile.read(wav)
        soundfile.write(wav, samples[: int((5.7 if wav.stem == DUET else 5.1) * rate)], rate)
    recipe = RECIPE | {"audio": {"librosa35": {}}}
    dancedata.build(recipe, copy, tmp_path / "store", jobs=1, cache=tmp_path / "cache", progress=False)
    out = tmp_path / "out"
    dancedata.export(tmp_path / "store", "tcdiff", out=out, source=copy)
    train = [path.stem for path in slices(out, "train", "wavs_sliced", ".wav")]
    assert train == [f"{DUET}_slice0", f"{DUET}_slice1"]
    [path] = slices(out, "test", "feats438", ".npy")
    rows, wav = np.load(path), out / "test" / "wavs_sliced" / f"{path.stem}.wav"
    assert rows.shape == (301, 438)
    feature: Any = FEATURES.make("bailando438", {"onset_fmax": "nyquist"})
    np.testing.assert_array_equal(rows, feature.extract(load_audio(wav), FrameGrid.of(60)))


def test_what_is_missing_is_named(source: Path, built: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with raises_message(StoreError, "no music below", where="store"):
        dancedata.export(built, "tcdiff", out=tmp_path / "a", source=tmp_path / "empty")
    with raises_message(StoreError, "aist[+][+]-60", where="store"):
        dancedata.export(built, "tcdiff", out=tmp_path / "b", source=source, feature="librosa35")


# ---- duolando: joints, rotation matrices and music of duets, as Duolando's scripts make them


Arrays = dict[str, np.ndarray]
DUETS: dict[str, Any] = {
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
def duets(golden: Arrays, tmp_path_factory: pytest.TempPathFactory) -> Path:
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
def exported(duets: Path, cache: Path) -> Path:
    store = duets.parent / "store"
    dancedata.build(DUETS, duets, store, jobs=1, cache=cache, progress=False)
    return dancedata.export(store, "duolando", duets.parent / "out", progress=False).path


def test_the_loaders_folders(exported: Path) -> None:
    files = {path.relative_to(exported).as_posix() for path in exported.rglob("*.npy")}
    expected = {f"music/feature/{split}/{pair}.npy" for pair, split in PAIRS.items()}
    for kind in ("pos3d", "rotmat"):
        expected |= {f"motion/{kind}/{split}/{pair}_0{k}.npy" for pair, split in PAIRS.items() for k in (0, 1)}
    assert files == expected


@pytest.mark.parametrize("pair", PAIRS)
def test_joints_and_rotations_are_duolandos(golden: Arrays, exported: Path, pair: str) -> None:
    n = len(golden["index"])
    for member, role in enumerate(("follower", "leader")):
        joints, rotmat = (
            np.load(exported / "motion" / kind / PAIRS[pair] / f"{pair}_0{member}.npy")
            for kind in ("pos3d", "rotmat")
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


def test_music_has_the_rows_of_the_motion(golden: Arrays, duets: Path, exported: Path) -> None:
    for pair, split in PAIRS.items():
        rows = np.load(exported / "music" / "feature" / split / f"{pair}.npy")
        song = load_audio(duets / "music" / "mp3" / "all" / f"{pair}.wav")
        assert (rows.dtype, rows.shape) == ("f4", (len(golden["index"]), 54))
        np.testing.assert_allclose(rows, Bailando54().extract(song, FrameGrid.of(30))[: len(rows)], atol=1e-4)


def write_duets(out: Path, group: str = "") -> None:
    """A store of groups of two, three and one dancer without fingers or roles."""
    clips = []
    for clip in stored({"train": (2, 3), "test": (2,)}):
        rows = np.full((clip.n_frames, 54), 0.5, np.float32)
        name, id = (clip.group and f"{group}{clip.group}"), f"{group}{clip.id}"
        clips.append(replace(clip, id=id, group=name, audio={"rows54": AudioBlock(name or id, rows)}))
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


def test_a_missing_feature_is_named(tmp_path: Path, cache: Path) -> None:
    source = tmp_path / "source"
    DATASETS.get("synthetic")().make_example(source)
    recipe = DUETS | {"dataset": {"synthetic": {}}, "motion": {"joints": {}}, "audio": {"librosa35": {}}}
    dancedata.build(recipe, source, tmp_path / "store", jobs=1, cache=cache, progress=False)
    with raises_message(StoreError, "bailando54", where="store"):
        dancedata.export(tmp_path / "store", "duolando", tmp_path / "out", progress=False)


def test_names_that_the_loader_changes_are_refused(tmp_path: Path) -> None:
    """It takes the path of rotation matrices from that of joints, with every pos3d replaced."""
    write_duets(tmp_path / "store", "pos3d-")
    with raises_message(StoreError, "pos3d-train0_p1", where="store"):
        dancedata.export(tmp_path / "store", "duolando", tmp_path / "out", progress=False, feature="rows54")

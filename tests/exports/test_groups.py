"""The exports of groups: gcd gives AIOZ-GDANCE's files back, tcdiff slices, their sound and their columns."""

import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.spatial.transform import Rotation

import dancedata
from dancedata.core.errors import StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import DATASETS, FEATURES
from dancedata.exports.gcd import sequence_name
from dancedata.music.signal import load_audio
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

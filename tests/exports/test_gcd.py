"""The export gcd: AIOZ-GDANCE's files come back from a dataset of its groups."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.spatial.transform import Rotation

import dancedata
from dancedata.core.errors import StoreError
from dancedata.core.registry import DATASETS
from dancedata.exports.gcd import sequence_name
from tests.messages import raises_message


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

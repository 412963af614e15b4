"""The export tcdiff: slices of groups, their sound, and the columns of each slice by itself."""

import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata.core.errors import StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import DATASETS, FEATURES
from dancedata.music.signal import load_audio
from tests.messages import raises_message

RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "groups", "dataset": {"aioz-gdance": {}}, "windows": {"length_s": 5, "stride_s": 0.5},
    "motion": {"edge151": {}}, "audio": {"bailando438": {"fps": 60}},
}  # fmt: skip
DUET, FIVE = "-Ab_cdEf123_01_0_180", "Zz9_8-7_6Q1_02_300_481"


pytestmark = pytest.mark.usefixtures("quick_bailando438")


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

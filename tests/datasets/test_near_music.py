"""Missing music: the likely file is named, for every reader that matches music by name; no unrelated file is."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dancedata.core.clip import Reject, Scan
from dancedata.core.registry import DATASETS
from dancedata.datasets._near_music import NearMusic


def near(source: Path, *names: str, other: Callable[[str], bool] = lambda stem: False) -> NearMusic:
    for name in names:
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_bytes(b"")
    return NearMusic(source, (source / "wavs", source), set(), other)


@pytest.mark.parametrize(
    ("file", "fix"),
    [
        ("wavs/MJS2.WAV", "mv -n wavs/MJS2.WAV wavs/mJS2.wav"),
        ("wavs/mJS2 (1).mp3", "mv -n 'wavs/mJS2 (1).mp3' wavs/mJS2.mp3"),
        ("wavs/mJS02_48k.wav", "mv -n wavs/mJS02_48k.wav wavs/mJS2.wav"),
        ("wavs/mJS2.wma", "ffmpeg -n -i wavs/mJS2.wma wavs/mJS2.wav"),
        ("songs of AIST/mJS2.wav", "mv -n 'songs of AIST/mJS2.wav' wavs/mJS2.wav"),
        ("wavs/all/mJS2.wav", "mv -n wavs/all/mJS2.wav wavs/mJS2.wav"),
        ("mJS2.ogg", "mv -n mJS2.ogg wavs/mJS2.ogg"),
    ],
)
def test_a_file_with_nearly_the_name(tmp_path: Path, file: str, fix: str) -> None:
    assert near(tmp_path, file).fix("wavs/mJS2") == fix


@pytest.mark.parametrize("file", ["wavs/mJS3.wav", "wavs/mJS20.wav", "wavs/mJB2.wav", "wavs/mJS2.txt", "wavs/2.wav"])
def test_another_song_is_not_offered(tmp_path: Path, file: str) -> None:
    assert near(tmp_path, file).fix("wavs/mJS2") == ""


def test_a_proper_name_of_something_else_is_not_offered(tmp_path: Path) -> None:
    files = near(tmp_path, "wavs/gJS_sBM_cAll_d01_mJS2_ch01.wav", other=lambda stem: stem.startswith("g"))
    assert files.fix("wavs/mJS2") == ""


def test_readable_files_are_offered_first(tmp_path: Path) -> None:
    assert near(tmp_path, "wavs/mJS2.wma", "wavs/mjs2.wav").fix("wavs/mJS2").startswith("mv -n wavs/mjs2.wav")


def test_a_misspelt_name_with_the_same_numbers(tmp_path: Path) -> None:
    files = near(tmp_path, "wavs/anna_walz_2.wav", "wavs/anna_waltz_3.wav")
    assert files.fix("wavs/anna_waltz_2") == "mv -n wavs/anna_walz_2.wav wavs/anna_waltz_2.wav"


def missing(scan: Scan) -> dict[str, Reject]:
    return {reject.music: reject for reject in scan.rejects if reject.reason == "missing_music"}


@pytest.fixture
def example(tmp_path: Path) -> Callable[[str], Path]:
    """Return a function: write a dataset's example."""

    def write(name: str) -> Path:
        DATASETS.get(name)().make_example(tmp_path / "source")
        return tmp_path / "source"

    return write


def test_aistpp_names_the_song_and_the_file(example: Any) -> None:
    source = example("aist++")
    (source / "wavs" / "mBR0.wav").rename(source / "wavs" / "MBR0.WAV")
    (source / "wavs" / "mHO3.wav").unlink()
    found = missing(DATASETS.get("aist++")().scan(source))
    assert {song: reject.fix for song, reject in found.items()} == {
        "mBR0": "mv -n wavs/MBR0.WAV wavs/mBR0.wav",
        "mHO3": "",
    }


def test_aistpp_in_edges_layout_too(example: Any, tmp_path: Path) -> None:
    source = example("aist++")
    for path in (source / "motions").iterdir():
        music = path.stem.split("_")[4]
        shutil.copy(source / "wavs" / f"{music}.wav", source / "wavs" / f"{path.stem}.wav")
    for path in (source / "wavs").glob("m*.wav"):
        path.unlink()
    one = sorted((source / "wavs").iterdir())[0]
    one.rename(one.with_name(one.name.lower()))
    (reject,) = missing(DATASETS.get("aist++")().scan(source)).values()
    assert reject.fix == f"mv -n wavs/{one.name.lower()} wavs/{one.name}"


def test_finedance_names_it_for_optional_clips(example: Any) -> None:
    source = example("finedance")
    (source / "music_wav" / "001.wav").rename(source / "music_wav" / "1.wav")
    fixes = {clip.id: clip.music_fix for clip in DATASETS.get("finedance")().scan(source).clips}
    assert fixes.pop("001") == "mv -n music_wav/1.wav music_wav/001.wav"
    assert set(fixes.values()) == {""}


def test_a_folder_with_names_that_match(example: Any) -> None:
    source = example("folder")
    (source / "manifest.csv").unlink()
    (source / "music" / "slow.wav").rename(source / "music" / "AMASS.WAV")
    found = missing(DATASETS.get("folder")().scan(source))
    assert found["amass_poses"].fix == "mv -n music/AMASS.WAV music/amass_poses.wav"
    assert found["smpl"].fix == ""


def test_a_folder_with_a_manifest(example: Any) -> None:
    source = example("folder")
    (source / "music" / "slow.wav").rename(source / "music" / "Slow.WAV")
    found = missing(DATASETS.get("folder")().scan(source))
    assert {reject.fix for reject in found.values()} == {"mv -n music/Slow.WAV music/slow.wav"}
    assert set(found) == {"music/slow.wav"}

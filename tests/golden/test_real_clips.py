"""The main job on real input: four published AIST++ clips and two real songs, in the official layout."""

import shutil
from pathlib import Path

import pytest
import soundfile

import dancedata
from dancedata.building.build import build
from dancedata.recipes.parse import load_recipe
from dancedata.store import Store, verify_store

# The clips' own songs may not be passed on: these stand in under the ids that the clips ask for.
SONGS = {
    "mBR2": "Kevin_MacLeod_-_Vibe_Ace",
    "mJS2": "Kevin_MacLeod_-_Vibe_Ace",
    "mJS4": "Karissa_Hobbs_-_Lets_Go_Fishin",
}
FRAMES = {
    "gBR_sBM_cAll_d04_mBR2_ch08": 576,
    "gBR_sBM_cAll_d06_mBR2_ch06": 576,
    "gJS_sBM_cAll_d03_mJS2_ch07": 576,
    "gJS_sFM_cAll_d02_mJS4_ch09": 1919,
}


@pytest.fixture(scope="module")
def store(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Store:
    real = shared / "realdata"
    folder = tmp_path_factory.mktemp("real")
    source = folder / "aist_plusplus_final"
    for name in ("motions", "splits", "cameras"):
        shutil.copytree(real / "aistpp" / name, source / name)
    shutil.copy(real / "aistpp" / "ignore_list.txt", source)
    (source / "wavs").mkdir(mode=0o755)
    for music, title in SONGS.items():
        # 35 s are more than the longest clip needs, and the whole songs would cost the tests half a minute.
        samples, rate = soundfile.read(real / "music" / f"{title}.hq.ogg", frames=35 * 44100)
        soundfile.write(source / "wavs" / f"{music}.wav", samples, rate, subtype="PCM_16")
    build(load_recipe("aist++"), source, folder / "out", jobs=1, cache=folder / "cache")
    return dancedata.open(folder / "out")


def test_builds_checks_and_reads(store: Store) -> None:
    assert [p for p in verify_store(store.path) if p.severity == "error"] == []
    windows = store.windows("train")
    per_clip = {clip: sum(w.clip == clip for w in windows) for clip in FRAMES}
    # 288 frames at 30 FPS: (288 - 150) // 15 + 1; 960 frames: 55, one more than EDGE's count at 60 FPS.
    assert per_clip == dict(zip(FRAMES, (10, 10, 10, 55), strict=True))
    for window in (windows[0], windows[-1]):
        assert store.read(window, "edge151").shape == (150, 151)
        assert store.read(window, "librosa35").shape == (150, 35)


def test_missing_packages_are_named(store: Store) -> None:
    missing = {r["clip"] for r in store.rejects if r["reason"] == "missing_motion"}
    assert len(missing) == 988  # 1,020 names in the three split files, less 28 ignored, less these 4
    assert "gLH_sBM_cAll_d17_mLH4_ch01" in missing


def test_known_glitches_are_flagged(store: Store) -> None:
    turns = [f for f in store.quality if f["kind"] == "fast_turn"]
    assert len(turns) == len(store.quality)
    steps = {clip: len({f["frame"] for f in turns if f["clip"] == clip}) for clip in FRAMES}
    assert list(steps.values()) == [13, 0, 0, 17]
    worst = max((f for f in turns if f["clip"] == "gBR_sBM_cAll_d04_mBR2_ch08"), key=lambda f: f["value"])
    assert (worst["joint"], worst["frame"], round(worst["value"])) == ("left_knee", 347, 176)
    worst = max((f for f in turns if f["clip"] == "gJS_sFM_cAll_d02_mJS4_ch09"), key=lambda f: f["value"])
    assert (worst["frame"], round(worst["value"])) == (1449, 177)


def test_songs_of_equal_samples_and_tempo_are_stored_once(store: Store) -> None:
    # mBR2 and mJS2 are one recording at one tempo (100 BPM by name), mJS4 (120) is another.
    rows = [35 * 30 + 1] * 2
    assert store.stats["fields"]["librosa35"]["n"] <= sum(rows)
    assert {c.tempo_bpm for c in store} == {100.0, 120.0}

"""The commands plan, check, info, list and features, through the command line: text, JSON, exit codes."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata.building.describe import describe_problems
from dancedata.core.registry import DATASETS
from dancedata.store import Problem
from tests.commands import as_json, run

RECIPES = {"track": "aist++", "window": "aist++-edge-exact"}
TRAIN = "gHO_sBM_cAll_d19_mHO3_ch03"
VAL = "gBR_sBM_cAll_d04_mBR0_ch01"


@pytest.fixture
def worn(source: Path) -> Path:
    """A corpus in which a clip is broken, of another one the song too, and a song ends half a second too early."""
    both = "gPO_sBM_cAll_d10_mPO0_ch01"
    for name in (TRAIN, both):
        (source / "motions" / f"{name}.pkl").write_bytes(b"")
    (source / "wavs" / "mPO0.wav").write_bytes(b"")
    with (source / "splits" / "crossmodal_train.txt").open("a") as names:
        names.write(f"{both}\n")
    wav = source / "wavs" / "mBR0.wav"
    samples, rate = soundfile.read(wav)
    soundfile.write(wav, samples[: int(5.6 * rate)], rate)
    return source


# plan


@pytest.mark.parametrize("scope", RECIPES)
def test_a_plan_counts_the_units_of_a_build(worn: Path, out: Path, scope: str):
    plan = as_json("build", "--dry-run", RECIPES[scope], worn, "--out", out)
    assert not out.exists()
    built = as_json("build", RECIPES[scope], worn, "--out", out, "--jobs", 1)
    assert plan["left_out"] == built["rejects"]
    assert plan["left_out"].keys() >= {"broken_file", "broken_audio", "no_audio"}
    assert plan["splits"].keys() == built["splits"].keys()
    for split, counts in plan["splits"].items():
        assert counts == {name: built["splits"][split][name] for name in counts}
    assert plan["recipe_sha256"] == built["recipe_sha256"]
    shards = sum(p.stat().st_size for p in out.glob("*-of-*.h5"))
    assert 0.8 * shards < plan["bytes"] < 1.2 * shards
    fields = {name: (f["columns"], f["dtype"]) for name, f in plan["fields"].items()}
    assert fields == {name: (f["columns"], f["dtype"]) for name, f in built["fields"].items()}


def test_a_plan_shows_cached_units(corpus: Path, out: Path, tmp_path: Path):
    where = ("aist++", corpus, "--out", out, "--cache", tmp_path / "cache")

    def cached(*overrides: str) -> dict[str, list[int]]:
        words = [word for override in overrides for word in ("--set", override)]
        held = as_json("build", "--dry-run", *where, *words)["cached"]
        assert held["librosa35"]["unit"] == "songs"
        return {name: [units["cached"], units["of"]] for name, units in held.items()}

    before = cached()
    assert before["edge151"] == [0, 4]
    assert before["librosa35"][0] == 0
    run("build", *where, "--jobs", 1)
    computed = len(list((tmp_path / "cache" / "features").rglob("*.npy")))
    assert cached() == {"edge151": [4, 4], "librosa35": [computed, computed]}
    assert cached("audio.librosa35.tightness=1") == {"edge151": [4, 4], "librosa35": [0, computed]}
    assert cached("motion.edge151.contacts.velocity.max_speed_m_s=1")["edge151"] == [0, 4]
    next((tmp_path / "cache" / "features").rglob("*.npy")).unlink()
    assert cached()["librosa35"] == [computed - 1, computed]
    output = run("build", "--dry-run", *where).stdout
    assert "edge151: 151 columns, float32; in the cache: 4 of 4 clips" in output


# check


def test_a_check_makes_no_corpus(corpus: Path, tmp_path: Path):
    (tmp_path / "empty").mkdir()
    for name in DATASETS.names():
        run("check", tmp_path / "empty", "--recipe", name, code=1)
        run("check", tmp_path / "missing", "--recipe", name, code=1)
    assert [p.name for p in tmp_path.rglob("*")] == ["empty"]
    run("check", corpus, "--recipe", "aist++")


def test_a_source_is_checked_as_a_recipe_reads_it(tmp_path: Path):
    source = tmp_path / "source"
    DATASETS.get("folder")().make_example(source)
    (source / "manifest.csv").write_text("motion,audio\n" + "motions/hips.bvh,music/slow.wav\n")
    (bvh,) = source.rglob("*.bvh")
    bvh.rename(bvh.with_name("hips.bvh"))
    recipe = tmp_path / "own.yaml"
    recipe.write_text(
        "{recipe: 1, name: own, dataset: {folder: {unit: cm}}, windows: {length_s: 2, stride_s: 1}, motion: edge151}"
    )
    assert "undeclared" in run("check", source, "--recipe", "folder", code=1).stdout
    assert "cm (declared in the recipe)" in run("check", source, "--recipe", recipe).stdout
    again = run("check", source, "--recipe", recipe, "--set", "dataset.folder.unit=inch").stdout
    assert "inch (declared in the recipe)" in again


def test_check_lists_every_note_of_a_source_and_folds_files_left_out(tmp_path: Path):
    example, source = tmp_path / "example", tmp_path / "source"
    DATASETS.get("folder")().make_example(example)
    (source / "motions").mkdir(parents=True)
    (source / "music").mkdir()
    shutil.copy(example / "motions" / "amass_poses.npz", source / "motions" / "one.npz")
    for name in ("one", *(f"spare{number}" for number in range(5))):
        shutil.copy(example / "music" / "slow.wav", source / "music" / f"{name}.wav")
    text = run("check", source, "--recipe", "folder").stdout
    notes = DATASETS.get("folder")().scan(source).notes
    assert all(note in text for note in notes)
    (line,) = (line for line in text.splitlines() if "spare" in line)
    assert line.startswith("note: 5 unused_music: ")
    assert "2 more (all with --json); the first: " in line
    equal = [Problem("note", f"clip{k}", "words: none") for k in range(5)]
    assert describe_problems("a", equal).splitlines()[0].endswith("2 more (all with --json)")  # the text comes once


# info, list


# features


@pytest.mark.parametrize("scope", RECIPES)
def test_features_like_a_dataset_are_the_rows_that_it_holds(built_in, corpus, tmp_path, scope):
    with dancedata.open(built_in[scope]) as ds:
        clips = [clip for clip in ds if TRAIN in (clip.id, clip.slice_of)]
        bpm = clips[0].tempo_bpm
        args = ("features", corpus / "wavs" / "mHO3.wav", "--out", tmp_path, "--like", built_in[scope], "--bpm", bpm)
        (about,) = as_json(*args)["songs"]
        rows = np.load(tmp_path / about["file"])
        assert (about["window_starts"] is None) == (scope == "track")
        windows = [(clip.slice_start, window) for clip in clips for window in ds[clip.id].windows()]
        assert len(windows) == 3
        for first, window in windows:
            of_song = rows[window.start : window.start + window.length]
            assert np.array_equal(ds.read(window, "librosa35"), rows[first // 15] if scope == "window" else of_song)
    if scope == "window":
        assert about["window_starts"][:3] == [0, 15, 30]
    (slow,) = as_json(*args[:-1], 30)["songs"]
    assert not np.array_equal(np.load(tmp_path / slow["file"]), rows), "the tempo counts"


def test_features_of_a_song_shorter_than_a_window_are_wrong_usage(built_in: dict[str, Path], tmp_path: Path):
    song = tmp_path / "short.wav"
    soundfile.write(song, np.zeros(48_000), 48_000)
    args = ("features", song, "--out", tmp_path / "x", "--like", built_in["window"])
    assert "shorter than one window" in run(*args, code=2).stderr


def test_features_of_two_songs_of_one_name_are_refused(corpus: Path, tmp_path: Path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        shutil.copy(corpus / "wavs" / "mHO3.wav", tmp_path / folder / "song.wav")
    args = ("features", tmp_path / "a" / "song.wav", tmp_path / "b" / "song.wav", "--out", tmp_path / "x")
    assert "two songs" in run(*args, code=2).stderr

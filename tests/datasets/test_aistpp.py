"""The dataset reader aist++: layouts, split files, the ignore list, what is left out and why, motion files."""

import pickle
from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, SourceError
from dancedata.core.resources import manifest
from dancedata.datasets.aistpp import AistPP, crossmodal_split
from dancedata.formats.aist_names import parse_name, tempo_bpm
from tests.datasets.scans import IGNORED, TEST, TRAIN, UNASSIGNED, VAL, load, notes, rejects, splits
from tests.messages import raises_message


def test_official_layout(official: Any) -> None:
    scan = AistPP().scan(official.root)
    assert scan.layout == "official"
    assert splits(scan) == {TRAIN: "train", VAL: "val", TEST: "test"}
    clip = scan.clips[0]
    assert clip == ClipRef(
        TRAIN, official.root / "motions" / f"{TRAIN}.pkl", official.root / "wavs" / "mBR2.wav", "train", music="mBR2",
        tempo_bpm=100.0, genre="gBR", dancer="d04",
    )  # fmt: skip
    assert rejects(scan, "unassigned") == [UNASSIGNED]
    assert rejects(scan, "ignored") == [IGNORED]
    assert len(scan.rejects) == 2, "the song of an ignored clip is not unused"
    assert "one audio file per song in wavs/ (3 songs)" in notes(scan)
    assert "AIST++ has 1,408 sequences, copies of it have 1,408 (every sequence has its pickle), 1,363 (" in notes(
        scan
    )
    assert "Clips: 1 train, 1 val, 1 test; left out: 1 ignored, 1 unassigned." in scan.notes


def test_edge_layout(empty_copy: Any) -> None:
    """As EDGE leaves it when it has sliced its data."""
    for name in (TRAIN, TEST):
        empty_copy.motion(name, folder="edge_aistpp/motions")
        empty_copy.song(f"edge_aistpp/wavs/{name}.wav")
        empty_copy.motion(name, folder=f"{name[-1]}/motions")
    scan = AistPP().scan(empty_copy.root)
    assert scan.layout == "edge"
    assert [clip.audio_path.name for clip in scan.clips if clip.audio_path] == [f"{TRAIN}.wav", f"{TEST}.wav"]
    assert scan.rejects == ()
    assert "one audio file per sequence in edge_aistpp/wavs/" in notes(scan)
    assert "Not read: 2/, 8/" in notes(scan)


def test_mixed_music_own_file_wins(official: Any) -> None:
    own = official.song(f"wavs/{TRAIN}.wav")
    official.song(f"wavs/{UNASSIGNED}.wav")
    official.song("audio/mJB2.wav")
    scan = AistPP().scan(official.root)
    assert scan.layout == "mixed"
    assert scan.clips[0].audio_path == own
    assert "2 files of a sequence, which is preferred" in notes(scan)
    assert rejects(scan, "unused_music") == ["audio/mJB2.wav", "wavs/mBR2.wav"]


@pytest.mark.parametrize("file", ["music/mBR2.FLAC", "audio/mBR2.mp3", "musics/mBR2.Ogg", "mBR2.WAV"])
def test_music_folders_and_extensions(empty_copy: Any, file: str) -> None:
    empty_copy.motion(TRAIN)
    empty_copy.write("LICENSE", b"not inspected")
    path = empty_copy.song(file)
    scan = AistPP().scan(empty_copy.root)
    assert scan.clips[0].audio_path == path
    assert scan.rejects == ()


def test_missing_motion_from_the_mapping(official: Any) -> None:
    absent = "gBR_sBM_cAll_d04_mBR2_ch09"
    in_no_split = "gBR_sBM_cAll_d05_mBR2_ch01"
    names = [f"{name} setting1" for name in (TRAIN, absent, in_no_split, "gJB_sBM_cAll_d07_mJB3_ch01")]
    official.names("cameras/mapping.txt", *names)
    assert rejects(AistPP().scan(official.root), "missing_motion") == [absent]
    assert rejects(AistPP(split="all").scan(official.root), "missing_motion") == [absent, in_no_split]


def test_tempos() -> None:
    assert [tempo_bpm(f"mBR{n}") for n in range(6)] == [80, 90, 100, 110, 120, 130]
    assert [tempo_bpm(f"mHO{n}") for n in range(6)] == [110, 115, 120, 125, 130, 135]
    assert [tempo_bpm(music) for music in ("mXX1", "mBR6", "mBR12", "mBR00", "BR0", "")] == [None] * 6
    assert sorted(manifest("aistpp")["tempo_bpm"]) == sorted(manifest("aistpp")["genres"])


def test_unknown_music_letters(empty_copy: Any) -> None:
    empty_copy.motion("gXX_sFM_cAll_d40_mXX1_ch01")
    empty_copy.song("wavs/mXX1.wav")
    scan = AistPP().scan(empty_copy.root)
    assert scan.clips[0].tempo_bpm is None
    assert scan.clips[0].genre == "gXX"
    assert scan.clips[0].notes == ("the tempo of music mXX1 is unknown",)
    assert "no rule for mXX1" in notes(scan)


@pytest.mark.parametrize(
    "stem",
    ["", "mBR0", f"{TRAIN} ", f" {TRAIN}", f"{TRAIN}\n", TRAIN.lower(), f"{TRAIN}_2", "gBR_sBM_cAll_d0٤_mBR2_ch08"],
)
def test_no_sequence_names(stem: str) -> None:
    assert parse_name(stem) is None


def test_rule_and_lists_against_all_real_names(shared: Path) -> None:
    real = shared / "realdata" / "aistpp"
    names = [line.split()[0] for line in (real / "cameras" / "mapping.txt").read_text().splitlines()]
    found = {name: crossmodal_split(parts) for name in names if (parts := parse_name(name))}
    ignored = set((real / "ignore_list.txt").read_text().split())
    assert len(found) == manifest("aistpp")["sequences"] == 1408
    assert Counter(found.values()) == {"train": 980, "val": 20, "test": 20, "": 388}
    assert set(manifest("aistpp")["ignored"]) == ignored
    assert len(ignored) == 45
    assert Counter(split for name, split in found.items() if name not in ignored)["train"] == 952
    assert Counter(split for name, split in found.items() if name not in ignored)[""] == 371
    for split in ("train", "val", "test"):
        listed = (real / "splits" / f"crossmodal_{split}.txt").read_text().split()
        assert {name for name in found if found[name] == split} == set(listed)
    songs = {name.split("_")[4] for name in names}
    assert len(songs) == 60
    assert all(tempo_bpm(song) for song in songs)


def test_split_files_alone_decide(official: Any) -> None:
    official.names("splits/crossmodal_test.txt", TRAIN)
    scan = AistPP().scan(official.root)
    assert splits(scan) == {TRAIN: "test"}
    assert scan.clips[0].lists == ("crossmodal_test",)
    assert rejects(scan, "unassigned") == sorted([VAL, TEST, UNASSIGNED])
    assert "no crossmodal_train.txt, so train is empty" in notes(scan)


def test_split_file_as_windows_saves_it(official: Any) -> None:
    text = f"\ufeff{TRAIN}\r\n# mine\r\n\r\n  {TRAIN} \r\n{VAL}"
    official.write("splits/crossmodal_train.txt", text.encode())
    scan = AistPP().scan(official.root)
    assert splits(scan) == {TRAIN: "train", VAL: "train"}
    assert "lists some names more than once" in notes(scan)


def test_an_own_split(official: Any) -> None:
    official.names("splits/mine_train.txt", TEST)
    assert splits(AistPP(split="mine").scan(official.root)) == {TEST: "train"}
    assert splits(AistPP().scan(official.root)) == {TRAIN: "train", VAL: "val", TEST: "test"}, "rule: no such file"
    scan = AistPP(split="all").scan(official.root)
    assert splits(scan) == dict.fromkeys(sorted([TRAIN, VAL, TEST, UNASSIGNED]), "all")
    assert rejects(scan, "ignored") == [IGNORED]


@pytest.mark.parametrize(
    ("split", "word", "where"),
    [("min", r"min_val\.txt", "мой dänce 舞/splits"), ("mine", r"mine_val\.txt", "no folder splits/ in the source")],
)
def test_no_such_split(official: Any, split: str, word: str, where: str) -> None:
    if split == "min":
        official.names("splits/mine_train.txt", TEST)
    with raises_message(SourceError, word, where=where):
        AistPP(split=split).scan(official.root)


def test_clip_in_two_splits(official: Any) -> None:
    official.names("splits/crossmodal_train.txt", TRAIN, TEST)
    official.names("splits/crossmodal_test.txt", TEST)
    with raises_message(SourceError, "gJS_sBM_cAll_d03_mJS3_ch02"):
        AistPP().scan(official.root)


@pytest.mark.parametrize("file", ["ignore_list.txt", "splits/ignore_list.txt"])
def test_ignore_list_of_the_source_replaces_the_shipped_one(official: Any, file: str) -> None:
    official.names(file)
    scan = AistPP().scan(official.root)
    assert splits(scan)[IGNORED] == "train", "an empty list ignores nothing"
    official.names(file, TRAIN, "", "a_name_that_is_not_there")
    scan = AistPP().scan(official.root)
    assert rejects(scan, "ignored") == [TRAIN]
    assert f"Ignore list: {file}; 2 names, 1 of them among the motion files found." in scan.notes
    assert rejects(AistPP(ignore="none").scan(official.root), "ignored") == []
    official.names("ignore_list.txt", TRAIN)
    official.names("splits/ignore_list.txt", TEST)
    scan = AistPP().scan(official.root)
    assert rejects(scan, "ignored") == [TRAIN]
    assert "not used: splits/ignore_list.txt" in notes(scan)


def test_motion_is_canonical(official: Any) -> None:
    path = official.root / "motions" / f"{TRAIN}.pkl"
    motion = load(AistPP(), path)
    raw = official.content()
    assert motion.grid.rate == Fraction(60)
    assert motion.skeleton.name == "SMPL24" or len(motion.skeleton.joints) == 24
    assert motion.rotations.dtype == motion.translation.dtype == np.float64
    assert np.array_equal(motion.rotations, raw["smpl_poses"].astype(np.float64).reshape(-1, 24, 3))
    assert np.array_equal(motion.translation, raw["smpl_trans"].astype(np.float64) / 93.75)
    assert not motion.rotations.flags.writeable


@pytest.mark.parametrize("scaling", [93.75, np.float32(93.75), np.array(93.75), np.array([[93.75]]), [93.75]])
def test_other_forms_of_the_same_motion(official: Any, scaling: Any) -> None:
    poses = official.content()["smpl_poses"].reshape(-1, 24, 3)
    path = official.motion("x", smpl_poses=poses, smpl_scaling=scaling, smpl_loss=None, extra=["kept", 1])
    reference = load(AistPP(), official.root / "motions" / f"{TRAIN}.pkl")
    assert np.array_equal(load(AistPP(), path).rotations, reference.rotations)
    assert np.array_equal(load(AistPP(), path).translation, reference.translation)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"smpl_scaling": None}, "missing_key"),
        ({"smpl_poses": [[1.0], [1.0, 2.0]]}, "bad_shape"),
        ({"smpl_scaling": np.array([-90.0])}, "bad_scaling"),
        ({"smpl_scaling": np.array([np.nan])}, "bad_scaling"),
        ({"smpl_scaling": np.array([1e-320])}, "bad_scaling"),
        ({"smpl_scaling": np.ones(2)}, "bad_shape"),
    ],
)
def test_bad_content(official: Any, changes: dict[str, Any], reason: str) -> None:
    path = official.motion("bad one ü", **changes)
    with raises_message(DataError, "floats|frames|smpl_poses|smpl_scaling|smpl_trans", reason=reason):
        load(AistPP(), path)
    path.write_bytes(pickle.dumps([1.0]))
    with raises_message(DataError, "dict", where="bad one ü.pkl", reason="broken_file"):
        load(AistPP(), path)

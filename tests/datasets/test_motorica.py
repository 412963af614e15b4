"""The dataset reader motorica: names, lists and their leaks, trims, music, BVH; joints against LDA's code."""

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.bodies import MOTORICA21
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.datasets.motorica import Motorica
from dancedata.datasets.motorica.labels import write_example as write_labels
from dancedata.datasets.motorica.motion import load_motion, write_example, write_recording
from dancedata.datasets.motorica.reader import IN_BOTH, TEST, parse_name
from dancedata.representations.lda61 import Lda61
from tests.datasets.scans import notes, rejects, splits
from tests.messages import raises_message

JAZZ = "kthjazz_gJZ_sFM_cAll_d02_mJZ_ch01_madeupswing_001"
TAP = "kthjazz_gTP_sFM_sngl_d02_015"
HIPHOP = "kthstreet_gLH_sFM_cAll_d01_mLH4_ch04"
POPPING = "kthstreet_gPO_sFM_cAll_d01_mPO_ch01_bombom_002"


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("motorica") / "мой dänce"
    write_example(folder, dance_s=2)
    return folder


@pytest.fixture
def source(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes files of these names, without content: a scan reads none."""

    def write(*names: str, without_music: tuple[str, ...] = ()) -> Path:
        for folder in ("bvh", "wav"):
            (tmp_path / "source" / folder).mkdir(parents=True, exist_ok=True)
        for name in names:
            (tmp_path / "source" / "bvh" / f"{name}.bvh").write_bytes(b"")
            if name not in without_music:
                (tmp_path / "source" / "wav" / f"{name}.wav").write_bytes(b"")
        return tmp_path / "source"

    return write


@pytest.mark.parametrize(
    ("stem", "song", "genre", "dancer"),
    [
        (POPPING, "bombom", "popping", "kthstreet_d01"), (HIPHOP, "mLH4", "hiphop", "kthstreet_d01"),
        ("kthstreet_gLH_sFM_cAll_d01_mLH_ch01_danstrams", "danstrams", "hiphop", "kthstreet_d01"),
        ("kthmisc_gCA_sFM_cAll_d01_mCA_ch0", "kthmisc_gCA_sFM_cAll_d01_mCA_ch0", "casual", "kthmisc_d01"),
        (TAP, TAP, "tap", "kthjazz_d02"),
        ("kthstreet_gXX_sFM_d01_two_words_001", "two_words", "", "kthstreet_d01"),
        ("any name", "any name", "", ""), ("", "", "", ""),
    ],
)  # fmt: skip
def test_names(stem: str, song: str, genre: str, dancer: str) -> None:
    name = parse_name(stem)
    assert (name.id, name.song, name.genre, name.dancer) == (stem, song, genre, dancer)


def test_scan(example: Path) -> None:
    scan = Motorica().scan(example)
    assert splits(scan) == {JAZZ: "train", TAP: "test", HIPHOP: "train", POPPING: "test"}
    first = scan.clips[0]
    assert (first.music, first.genre, first.dancer) == ("madeupswing", "jazz", "kthjazz_d02")
    assert (first.lists, first.keys) == (("lda_train",), (("song", "madeupswing"),))
    assert first.audio_path == example / "wav" / f"{JAZZ}.wav"
    assert len(rejects(scan, "missing_motion")) == len(TEST) - 2
    assert "Trims: off." in notes(scan), "off by default, and said"
    assert "read as 1/120 s exactly" in notes(scan)


def test_what_official_lists_share(source: Callable[..., Path]) -> None:
    both, same_song = IN_BOTH[0], "kthstreet_gLH_sFM_cAll_d02_mLH_ch01_thisisit_009"
    folder = source(both, same_song, *TEST)
    official = Motorica().scan(folder)
    assert splits(official)[both] == "test"
    assert splits(official)[f"{both}_lda-train"] == splits(official)[same_song] == "train"
    assert {c.lists for c in official.clips if both in c.id} == {("lda_train", "lda_test")}
    assert f"Leak: {both} is in LDA's lists of train and test" in notes(official)
    assert "thisisit (1 recording)" in notes(official)
    clean = Motorica(split="official-clean").scan(folder)
    assert set(splits(clean)) == set(TEST)
    assert rejects(clean, "ignored") == [same_song]


def test_music_beside_the_motion(source: Callable[..., Path]) -> None:
    folder = source(TAP, without_music=(TAP,))
    (folder / "bvh" / f"{TAP}.wav").write_bytes(b"")
    scan = Motorica().scan(folder)
    assert scan.clips[0].audio_path == folder / "bvh" / f"{TAP}.wav"
    assert rejects(scan, "extra_file") == []


def test_offsets_of_music(example: Path) -> None:
    scan = Motorica(audio_start={"mLH4": 0.08, TAP: "-1/3"}).scan(example)
    starts = {clip.id: clip.audio_start for clip in scan.clips}
    assert starts == {JAZZ: 0, TAP: Fraction(-1, 3), HIPHOP: Fraction(2, 25), POPPING: 0}
    assert "audio_start states the offset of 2 recordings" in notes(scan)
    with raises_message(SourceError, "audio_start"):
        Motorica(audio_start={"nothing": 1}).scan(example)
    with raises_message(UsageError, "audio_start"):
        Motorica(audio_start={TAP: "late"})


def test_trims(tmp_path: Path) -> None:
    write_example(tmp_path, ((JAZZ, "mJB2", 0.0),), dance_s=2, pose_s=1)
    reader = Motorica(trim_s=1, audio_start={JAZZ: 0.5})
    (clip,) = reader.scan(tmp_path).clips
    assert (clip.source_start, clip.source_end, clip.audio_start) == (1, 3, Fraction(3, 2))
    whole, part = Motorica().load(Motorica().scan(tmp_path).clips[0]), reader.load(clip)
    assert (whole.n_frames, part.n_frames) == (480, 240)
    assert np.array_equal(part.rotations, whole.rotations[120:360])
    assert not whole.rotations[:120].any(), "the T-pose"
    (clip,) = Motorica(trim_s=0.101).scan(tmp_path).clips
    assert clip.audio_start == clip.source_start == Fraction(12, 120), "whole frames"
    long = Motorica(trim_s=2)
    with raises_message(DataError, "trim_s", reason="too_short"):
        long.load(long.scan(tmp_path).clips[0])


def test_two_takes(tmp_path: Path) -> None:
    write_example(tmp_path, ((JAZZ, "mJB2", 0.0),), dance_s=2, pose_s=1)
    write_labels(tmp_path, JAZZ)
    reader = Motorica(takes="both", trim_s=1, audio_start={JAZZ: 0.5})
    scan = reader.scan(tmp_path)
    first, second = scan.clips
    assert (first.id, second.id) == (f"{JAZZ}_00", f"{JAZZ}_01")
    assert (second.source_start, second.source_end) == (1 + Fraction(1, 60), 3)
    assert (first.audio_start, second.audio_start) == (Fraction(3, 2), Fraction(3, 2) + Fraction(1, 60))
    assert [a.start - b.start for a, b in zip(first.segments, second.segments, strict=True)] == [Fraction(1, 60)] * 4
    assert "states the offset of 1 recording." in notes(scan)
    assert "NAME_01 begins 1/60 s later" in notes(scan)
    thirty, whole = FrameGrid.of(30), Motorica().load(Motorica().scan(tmp_path).clips[0])
    for clip, begin in ((first, 120), (second, 122)):
        motion = reader.load(clip).resampled(thirty)
        np.testing.assert_array_equal(motion.rotations, whole.rotations[begin:360:4])


def test_numbers_of_genres_are_ldas() -> None:
    assert list(Motorica().genre_ids.items()) == [
        ("casual", 0), ("charleston", 1), ("jazz", 2), ("krump", 3), ("hiphop", 4), ("locking", 5), ("popping", 6),
        ("tap", 7),
    ]  # fmt: skip


def test_a_dataset_in_ldas_columns(tmp_path: Path) -> None:
    write_example(tmp_path / "source", ((JAZZ, "mJB2", 0.0), (TAP, "mJS1", 0.0)), dance_s=6, pose_s=1)
    overrides = ["dataset.motorica.trim_s=1"]
    dancedata.build(
        "motorica-lda", tmp_path / "source", tmp_path / "out", overrides=overrides, cache=tmp_path / "cache", jobs=1,
        progress=False,
    )  # fmt: skip
    with dancedata.open(tmp_path / "out") as store:
        ids = {f"{JAZZ}_0{k}{copy}" for k in (0, 1) for copy in ("", "__mirror")} | {f"{TAP}_00", f"{TAP}_01"}
        assert {clip.id for clip in store} == ids
        assert [clip.split for clip in store if clip.id.startswith(TAP)] == ["test", "test"]
        rows = {name: store[name].read("lda61") for name in ids}
        assert rows[f"{JAZZ}_00"].shape == rows[f"{JAZZ}_01"].shape == (180, 61)
        image = Lda61().columns.mirror.apply(rows[f"{JAZZ}_01"])
        np.testing.assert_array_equal(rows[f"{JAZZ}_01__mirror"], image)
        assert len(store[f"{JAZZ}_00"].windows()) == 180 - 165 + 1
        music, of_copy = (store[f"{JAZZ}_01{copy}"].read("librosa35") for copy in ("", "__mirror"))
        assert music.shape == (180, 35)
        np.testing.assert_array_equal(of_copy, music)
        train = np.concatenate([rows[name] for name in sorted(ids) if name.startswith(JAZZ)])
        np.testing.assert_allclose(
            store.stats["fields"]["lda61"]["std"], train.std(axis=0, dtype=float), rtol=1e-4, atol=1e-6
        )


def test_motion(example: Path, tmp_path: Path) -> None:
    reader, kept = Motorica(), Motorica(fingers="keep")
    clip = reader.scan(example).clips[0]
    motion, full = reader.load(clip), kept.load(clip)
    assert (motion.n_frames, motion.grid.rate) == (240, 120), "0.008333 is 1/120"
    assert motion.skeleton.joints == MOTORICA21.joints
    assert motion.skeleton.name.startswith("motorica21:")
    np.testing.assert_allclose(motion.skeleton.offsets, MOTORICA21.offsets, atol=1e-8)
    assert full.skeleton.n_joints == 51
    body = [full.skeleton.index(joint) for joint in MOTORICA21.joints]
    np.testing.assert_array_equal(full.joints()[:, body], motion.joints())
    assert [full.skeleton.joints[j] for j in full.skeleton.pairs[-1]] == ["LeftToeBase", "RightToeBase"]
    for frame_time in ("0.0083333", "0.00833", ".00833333333"):
        write_recording(tmp_path / "a.bvh", 0, dance_s=0.1, frame_time=frame_time)
        assert load_motion(tmp_path / "a.bvh", fingers=False).grid.rate == 120


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("Frame Time: 0.008333", "Frame Time: 0.0333", "bad_rate"),
        ("CHANNELS 6 Xposition", "CHANNELS 5", "missing_channels"),
        ("JOINT LeftToeBase", "JOINT LeftToe", "bad_skeleton"),
        ("JOINT LeftHandThumb2", "JOINT LeftForeArm", "bad_skeleton"),
        ("OFFSET 28.700000 0.000000", "OFFSET 0 0", "bad_skeleton"),
        ("OFFSET 0.000000 -35.700000", "OFFSET 0.000000 -0.357000", "bad_unit"),
    ],
)
def test_bad_files(tmp_path: Path, old: str, new: str, reason: str) -> None:
    path = tmp_path / "a.bvh"
    write_recording(path, 0, dance_s=0.5)
    text = path.read_text()
    assert old in text
    if reason == "missing_channels":
        head, rows = text.split("Frame Time: 0.008333\n")
        text = "\n".join([f"{head}Frame Time: 0.008333", *(row.split(" ", 1)[1] for row in rows.splitlines())])
    path.write_text(text.replace(old, new, 1))
    with raises_message(DataError, "Frames|Xposition|captures|points", reason=reason):
        load_motion(path, fingers=False)


def test_joints_and_rotations_are_ldas(shared: Path) -> None:
    crowd = shared / "golden" / "crowd"
    facts = json.loads((crowd / "motorica" / "facts.json").read_text())
    arrays = np.load(crowd / "motorica" / "expmap61.npz")
    files = sorted((crowd / "inputs" / "motorica" / "bvh").glob("*.bvh"))
    assert files
    for path in files:
        motion = load_motion(path, fingers=False)
        assert list(motion.skeleton.joints) == facts["position_joints"]
        joints, n = motion.joints() * 100, motion.n_frames
        expected = arrays[f"{path.stem}.joint_positions_cm_first_mid_last"]
        np.testing.assert_allclose(joints[[0, n // 2, n - 1]], expected, atol=1e-4)
        names = [column.split("_") for column in facts["columns"]]
        for take in (0, 1):
            rows = arrays[f"{path.stem}_0{take}"]
            np.testing.assert_allclose(rows[:, 57], joints[2 * take :: 4, 0, 1], atol=1e-4)
            for column, (joint, axis) in enumerate(names[:54]):
                ours = motion.rotations[
                    2 * take :: 4, motion.skeleton.index(joint), ["alpha", "beta", "gamma"].index(axis)
                ]
                np.testing.assert_allclose(rows[:, column], ours, atol=1e-5)

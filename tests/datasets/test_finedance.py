"""The dataset reader finedance: layout, lists, genres, what is left out and why, motion files."""

from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.bodies import SMPLX52, SMPLX55
from dancedata.core.clip import ClipRef, Scan
from dancedata.core.errors import DataError
from dancedata.core.resources import manifest
from dancedata.core.rotations import matrix_from_rotvec, rotation_6d
from dancedata.datasets.aistpp import AistPP
from dancedata.datasets.files import SPLITS
from dancedata.datasets.finedance import IDS, FineDance, genre_of, ignored_by, listed_in, trims
from tests.datasets.scans import notes, rejects, splits
from tests.messages import raises_message


def detail(scan: Scan, clip: str) -> str:
    (found,) = (r.detail for r in scan.rejects if r.clip == clip)
    return found


def test_layout(finedance: Any) -> None:
    finedance.write("music_npy/001.npy", b"x")
    finedance.write("mofea319/001.npy", b"x")
    scan = FineDance().scan(finedance.root)
    assert scan.layout == "finedance"
    assert splits(scan) == {"001": "train", "004": "train", "063": "test", "130": "test", "159": "train"}
    motion, music = finedance.root / "motion" / "001.npy", finedance.root / "music_wav" / "001.wav"
    lists = ("cross_genre.train", "cross_dancer.test")
    assert scan.clips[0] == ClipRef("001", motion, music, "train", music="001", genre="Popping", lists=lists)
    assert rejects(scan, "ignored") == ["116", "120"]
    assert len(rejects(scan, "missing_motion")) == 211 - 7 - 7, "not those of the ignore list"
    assert len(scan.rejects) == 2 + 197
    assert "motion/*.npy (7 files); 7 audio files" in scan.notes[0]
    assert "Not read: mofea319/, music_npy/. Music features are computed from the audio." in scan.notes
    assert "FineDance has 211 sequences, 204 of which have no file here; label_json/ (7 files)" in notes(scan)
    assert "Clips: 3 train, 0 val, 2 test; left out: 2 ignored." in scan.notes


def test_folder_above(fine: Any) -> None:
    for root in ("FineDance/", "old copy/"):
        fine.motion("001", root=root)
    scan = FineDance(labels="optional").scan(fine.root)
    assert scan.clips[0].audio_path is None
    assert "Layout: FineDance, by FineDance/motion/*.npy" in scan.notes[0]
    assert "0 audio files" in scan.notes[0]
    assert "Not read: old copy/, which also contain motion/." in scan.notes


def test_the_manifest_is_consistent() -> None:
    raw = manifest("finedance")
    for name, protocol in raw["splits"].items():
        ignored = ignored_by(name)
        listed = [*protocol["val"], *protocol["test"]]
        assert len(set(listed)) == len(listed), "an id is in one split at most"
        assert set(listed) | ignored <= set(IDS)
        found = Counter(listed_in(name, clip) or "train" for clip in IDS if clip not in ignored)
        counts = {split: found[split] for split in SPLITS} | {"ignored": len(ignored)}
        assert counts == protocol["counts"]
        assert sum(counts.values()) == raw["sequences"] == len(IDS) == 211
    assert trims() == {
        "010": 3, "014": 3, "004": 240, "005": 300, "067": 180, "105": 570, "110": 420, "113": 870, "153": 1560,
        "211": 660,
    }  # fmt: skip
    assert all(trim["reason"] and trim["source"] for trim in raw["trims"])
    assert all(of["source"] for of in raw["ignore_lists"].values())


def test_ids_in_two_lists(finedance: Any) -> None:
    scan = FineDance().scan(finedance.root)
    assert detail(scan, "116") == "on the list ignored; keep: ['116'] keeps it"
    assert "in cross_genre.test; the ignore list takes precedence" in detail(scan, "120")
    assert "cross_genre has no val" in notes(scan)
    assert "130 (test) not ignored here; the trainer in FineDance's repository" in notes(scan)
    lists = {clip.id: clip.lists for clip in scan.clips}
    assert lists["130"] == ("cross_genre.test", "cross_dancer.test", "ignored.finenet")
    assert lists["159"] == ("cross_genre.train", "ignored.cross_dancer")


def test_cross_dancer(finedance: Any) -> None:
    finedance.sequence("117")
    finedance.sequence("135")
    scan = FineDance(split="cross_dancer").scan(finedance.root)
    assert splits(scan) == {"001": "test", "004": "test", "063": "train", "130": "test", "135": "val"}
    assert rejects(scan, "ignored") == ["116", "117", "120", "159"]
    assert "in cross_dancer.val" in detail(scan, "117")
    assert "no val" not in notes(scan)


@pytest.mark.parametrize(("keep", "there"), [(("120",), {"120": "test"}), ("all", {"116": "train", "120": "test"})])
def test_keep_by_name(finedance: Any, keep: Any, there: dict[str, str]) -> None:
    scan = FineDance(keep=keep).scan(finedance.root)
    assert {clip: split for clip, split in splits(scan).items() if clip in ("116", "120")} == there
    assert rejects(scan, "ignored") == sorted({"116", "120"} - set(there))
    lists = {clip.id: clip.lists for clip in scan.clips}
    assert lists["120"] == ("cross_genre.test", "ignored"), "a reader can still leave it out"


def test_ids_that_finedance_does_not_have(finedance: Any) -> None:
    for clip in ("000", "212"):
        finedance.sequence(clip)
    scan = FineDance().scan(finedance.root)
    assert rejects(scan, "unassigned") == ["000", "212"]
    assert "2 more have unknown ids" in notes(scan)


def test_genres_and_their_numbers() -> None:
    ids = FineDance().genre_ids
    assert ids == {
        "Breaking": 0, "Popping": 1, "Locking": 2, "Hiphop": 3, "Urban": 4, "Jazz": 5, "Tai": 6, "Uighur": 7,
        "Hmong": 8, "HanTang": 9, "ShenYun": 10, "Kun": 11, "DunHuang": 12, "Korean": 13, "Choreography": 14,
        "Chinese": 15,
    }  # fmt: skip
    synonyms = {"jazz": "Jazz", "Dai": "Tai", "Wei": "Uighur", "Miao": "Hmong", " hiphop ": "Hiphop", "Waltz": ""}
    assert {name: genre_of(name) for name in synonyms} == synonyms
    aist = ("gBR", "gPO", "gLO", "gMH", "gLH", "gHO", "gWA", "gKR", "gJS", "gJB")
    assert dict(AistPP().genre_ids) == {genre: k for k, genre in enumerate(aist)}


BAD_LABELS = [
    (None, "missing_label", "there is no label_json/001.json"),
    ({}, "missing_label", "no style2; keys found: none"),
    ({"style2": ""}, "missing_label", "no style2"),
    ({"style2": "Waltz"}, "unknown_genre", "'Waltz', not one of Breaking, Popping"),
    ({"style2": 3}, "unknown_genre", "style2 is 3"),
    ({"style2": "\ud800" * 99}, "unknown_genre", "..."),
    ([], "broken_label", "a list, not an object"),
    (b'{"style2": "\xff"}', "broken_label", "utf-8"),
    (b"[" * 100_000, "broken_label", "cannot be read"),
    (b" " * 2_000_000, "broken_label", "larger than"),
]


@pytest.mark.parametrize(("content", "reason", "words"), BAD_LABELS)
def test_bad_label(fine: Any, content: Any, reason: str, words: str) -> None:
    fine.motion("001")
    fine.motion("004")
    fine.label("004", {"style2": "Urban"})
    if content is not None:
        fine.label("001", content)
    scan = FineDance().scan(fine.root)
    assert splits(scan) == {"004": "train"}
    assert rejects(scan, reason) == ["001"]
    assert words in detail(scan, "001")
    assert detail(scan, "001").isascii()
    kept = FineDance(labels="optional").scan(fine.root)
    assert [clip.genre for clip in kept.clips] == ["", "Urban"]
    assert words in kept.clips[0].notes[0]
    assert "1 clip kept without a genre, as requested: 001" in notes(kept)


def load(path: Path, clip: str = "001", **fields: Any) -> Any:
    return FineDance(**fields).load(ClipRef(id=clip, motion_path=path, audio_path=None, split="train"))


def columns_of(motion: Any) -> Any:
    """The file's 315 columns of a motion."""
    rows = rotation_6d(matrix_from_rotvec(motion.rotations[:, [SMPLX55.index(j) for j in SMPLX52.joints]]))
    return np.concatenate([motion.translation, rows.reshape(motion.n_frames, -1)], axis=1)


def test_motion_is_canonical(fine: Any) -> None:
    raw = fine.columns()
    motion = load(fine.motion("001"))
    assert motion.grid.rate == Fraction(30)
    assert motion.skeleton is SMPLX55
    assert motion.trim_start == 0
    assert motion.rotations.dtype == motion.translation.dtype == np.float64
    assert not motion.rotations.flags.writeable
    assert np.array_equal(motion.translation, raw[:, :3].astype(np.float64))
    assert not motion.rotations[:, 22:25].any(), "jaw and eyes"
    assert np.abs(columns_of(motion) - raw).max() < 1e-6
    slightly_off = np.concatenate([raw[:, :3], raw[:, 3:] * 1.0005], axis=1)
    assert np.abs(columns_of(load(fine.motion("002", slightly_off))) - raw).max() < 1e-6
    left_index1 = SMPLX55.index("left_index1")
    assert np.abs(rotation_6d(matrix_from_rotvec(motion.rotations[0, left_index1])) - raw[0, 135:141]).max() < 1e-6


def test_cut_beginnings(fine: Any) -> None:
    path = fine.motion("004", fine.columns(300))
    assert load(path, "004").trim_start == 240
    assert load(path, "004").n_frames == 300
    assert load(path, "010").trim_start == 3
    with raises_message(DataError, "trim", where="мой dänce 舞/motion/004.npy", reason="too_short"):
        load(path, "005")


@pytest.mark.parametrize(
    ("columns", "values", "word", "where", "reason"),
    [
        (200, np.nan, "finite", "column 200", "nan"),
        (slice(3 + 6 * 22, 3 + 6 * 23), [2, 0, 0, 0, 1e30, 0], "normalise", "joint left_index1", "bad_rotation"),
    ],
)
def test_one_bad_value_is_named(fine: Any, columns: Any, values: Any, word: str, where: str, reason: str) -> None:
    raw = fine.columns()
    raw[17, columns] = values
    with raises_message(DataError, word, where=f"001.npy, frame 17, {where}", reason=reason):
        load(fine.motion("001", raw))


def test_columns_in_place_of_rows_are_recognised(fine: Any) -> None:
    raw = fine.columns()
    # (c0, c1) flattened row by row, from two rows that are taken for columns.
    raw[:, 3:] = raw[:, 3:].reshape(-1, 2, 3).swapaxes(1, 2).reshape(90, 312)
    with raises_message(DataError, "flattened", where="001.npy, frame 0, joint pelvis", reason="bad_rotation"):
        load(fine.motion("001", raw))

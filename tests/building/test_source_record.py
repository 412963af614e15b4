"""A dataset records the files of each clip: another source is reported file by file."""

import pickle
import shutil
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.building.differences import source_differences
from dancedata.building.source_record import MAX_CLIPS, SourceRecord
from dancedata.comparison import diff
from dancedata.core.errors import StoreError
from dancedata.testing.stores import write_random_store
from tests.messages import raises_message

TRAIN = "gHO_sBM_cAll_d19_mHO3_ch03"
OTHER = "gHO_sFM_cAll_d20_mHO3_ch01"
NEW = "gHO_sBM_cAll_d21_mHO3_ch03"
VAL = "gBR_sBM_cAll_d04_mBR0_ch01"


def motion(source: Path) -> None:
    path = source / "motions" / f"{TRAIN}.pkl"
    content = pickle.loads(path.read_bytes())
    content["smpl_trans"][0, 0] += 1
    path.write_bytes(pickle.dumps(content))


def song(source: Path) -> None:
    path = source / "wavs" / "mHO3.wav"
    path.write_bytes(path.read_bytes()[:-2] + b"\x01\x01")


def split(source: Path) -> None:
    lists = source / "splits"
    (lists / "crossmodal_val.txt").write_text("")
    (lists / "crossmodal_train.txt").write_text((lists / "crossmodal_train.txt").read_text() + f"{VAL}\n")


def no_song(source: Path) -> None:
    (source / "wavs" / "mHO3.wav").unlink()


def ignored(source: Path) -> None:
    (source / "ignore_list.txt").write_text(f"{TRAIN}\n")


def more(source: Path) -> None:
    shutil.copy(source / "motions" / f"{TRAIN}.pkl", source / "motions" / f"{NEW}.pkl")
    lists = source / "splits" / "crossmodal_train.txt"
    lists.write_text(lists.read_text() + f"{NEW}\n")


def spare(source: Path) -> None:
    shutil.copy(source / "wavs" / "mHO3.wav", source / "wavs" / "mHO5.wav")


@pytest.mark.parametrize(
    ("change", "lines"),
    [
        (motion, [f"different motion in 1 clip: motions/{TRAIN}.pkl"]),
        (song, ["different music in 2 clips: wavs/mHO3.wav"]),
        (
            split,
            [
                f"split of 1 clip, e.g. 'val' there, 'train' now: {VAL}",
                f"lists of 1 clip, e.g. ('crossmodal_val',) there, ('crossmodal_train',) now: {VAL}",
            ],
        ),
        (no_song, [f"2 clips used there, left out (missing_music) now: {TRAIN}, {OTHER}"]),
        (ignored, [f"1 clip used there, left out (ignored) now: {TRAIN}"]),
        (more, [f"1 clip absent there, used now: {NEW}"]),
        (spare, ["unused_music, only now: mHO5.wav"]),
    ],
)
def test_another_source_is_shown(run_build, source, built_copy, hashes, change, lines):
    before = hashes(built_copy)
    change(source)
    with raises_message(StoreError, "rebuild", where="outs/out") as caught:
        run_build(source, built_copy)
    found = [line.removeprefix("  - ") for line in str(caught.value).splitlines() if line.startswith("  - ")]
    assert found == lines
    assert hashes(built_copy) == before


def test_diff_shows_it_too(run_build: Any, source: Path, built: Path, out: Path):
    song(source)
    run_build(source, out)
    (found,) = [d for d in diff(built, out) if d.message == "different music in 2 clips"]
    assert (found.kind, found.names) == ("source", (TRAIN, OTHER))


def test_declared_attributes_of_a_clip_are_compared():
    one, two, three, four = (digit * 12 for digit in "1234")
    old = SourceRecord({"a": one + two + three, "b": one + two + three})
    new = SourceRecord({"a": one + two + four, "b": one + two + three})
    assert [str(d) for d in source_differences(old, new, "there", "now")] == ["what is declared of 1 clip: a"]


def test_a_clip_that_was_set_aside_later_is_known(run_build: Any, source: Path, out: Path):
    path = source / "motions" / f"{TRAIN}.pkl"
    content = pickle.loads(path.read_bytes())
    content["smpl_poses"][0, 0] = float("nan")
    path.write_bytes(pickle.dumps(content))
    run_build(source, out)
    motion(source)
    with raises_message(StoreError, "rebuild", where="outs/out"):
        run_build(source, out)


def test_a_dataset_without_a_record(tmp_path: Path):
    """One that another program wrote, or an earlier version."""
    made = write_random_store(tmp_path / "store")
    with dancedata.open(made.path) as ds:
        old = SourceRecord.of_store(ds)
    assert old.clips is None
    (difference,) = source_differences(old, SourceRecord({"a": "1" * 36}), "there", "now")
    assert "is not recorded" in difference.message


def test_the_record_of_many_clips_is_left_out():
    assert SourceRecord({str(number): "" for number in range(MAX_CLIPS + 1)}).to_json(()) == {}
    assert list(SourceRecord({"a": "1" * 36, "b": "2" * 36}).to_json({"a"})) == ["b"]

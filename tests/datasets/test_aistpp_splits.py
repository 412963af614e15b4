"""The dataset reader aist++: split files, the split rule, the ignore list."""

from typing import Any

import pytest

from dancedata.core.errors import SourceError, UsageError
from dancedata.datasets.aistpp import AistPP
from tests.datasets.scans import IGNORED, TEST, TRAIN, UNASSIGNED, VAL, notes, rejects, splits
from tests.messages import raises_message


def test_split_files_alone_decide(official: Any) -> None:
    official.names("splits/crossmodal_test.txt", TRAIN)
    scan = AistPP().scan(official.root)
    assert splits(scan) == {TRAIN: "test"}
    assert scan.clips[0].lists == ("crossmodal_test",)
    assert rejects(scan, "unassigned") == sorted([VAL, TEST, UNASSIGNED])
    assert "no crossmodal_train.txt, so train is empty" in notes(scan)


def test_split_file_as_windows_saves_it(official: Any) -> None:
    text = f"\ufeff# mine\r\n{TRAIN}\r\n\r\n  {TRAIN} \r\n{VAL}"
    official.write("splits/crossmodal_train.txt", text.encode())
    scan = AistPP().scan(official.root)
    assert splits(scan) == {TRAIN: "train", VAL: "train"}
    assert "lists some names more than once" in notes(scan)


def test_an_own_split(official: Any) -> None:
    official.names("splits/mine_train.txt", TEST)
    assert splits(AistPP(split="mine").scan(official.root)) == {TEST: "train"}
    assert splits(AistPP().scan(official.root)) == {TRAIN: "train", VAL: "val", TEST: "test"}, "rule: no such file"


@pytest.mark.parametrize("absolute", [True, False])
def test_split_dir(official: Any, absolute: bool) -> None:
    official.names("splits/crossmodal_train.txt", TRAIN)
    folder = official.names("my lists/crossmodal_val.txt", TEST).parent
    reader = AistPP(split_dir=str(folder) if absolute else "my lists")
    assert splits(reader.scan(official.root)) == {TEST: "val"}


def test_split_dir_in_the_folder_below(empty_copy: Any) -> None:
    empty_copy.motion(TRAIN, folder="aist_plusplus_final/motions")
    empty_copy.names("aist_plusplus_final/lists/crossmodal_val.txt", TRAIN)
    reader = AistPP(split_dir="lists", music="optional")
    assert splits(reader.scan(empty_copy.root)) == {TRAIN: "val"}


def test_no_such_split(official: Any) -> None:
    official.names("splits/mine_train.txt", TEST)
    with raises_message(SourceError, r"min_val\.txt", where="мой dänce 舞/splits"):
        AistPP(split="min").scan(official.root)


def test_no_split_folder(official: Any) -> None:
    with raises_message(SourceError, r"mine_val\.txt", where="no folder splits/ in the source"):
        AistPP(split="mine").scan(official.root)
    with raises_message(SourceError, r"NAME_val\.txt", where="мой dänce 舞/nowhere"):
        AistPP(split_dir="nowhere").scan(official.root)
    official.write("lists/other.txt", b"")
    with raises_message(SourceError, r"crossmodal_val\.txt", where="мой dänce 舞/lists"):
        AistPP(split_dir="lists").scan(official.root)


def test_clip_in_two_splits(official: Any) -> None:
    official.names("splits/crossmodal_train.txt", TRAIN, TEST)
    official.names("splits/crossmodal_test.txt", TEST)
    with raises_message(SourceError, "gJS_sBM_cAll_d03_mJS3_ch02"):
        AistPP().scan(official.root)


def test_all(official: Any) -> None:
    scan = AistPP(split="all").scan(official.root)
    assert splits(scan) == dict.fromkeys(sorted([TRAIN, VAL, TEST, UNASSIGNED]), "all")
    assert rejects(scan, "ignored") == [IGNORED]


@pytest.mark.parametrize("file", ["ignore_list.txt", "splits/ignore_list.txt"])
def test_ignore_list_of_the_source_replaces_the_shipped_one(official: Any, file: str) -> None:
    official.names(file)
    scan = AistPP().scan(official.root)
    assert splits(scan)[IGNORED] == "train", "an empty list ignores nothing"
    official.names(file, TRAIN, "", "a_name_that_is_not_there")
    scan = AistPP().scan(official.root)
    assert rejects(scan, "ignored") == [TRAIN]
    assert f"Ignore list: {file}; 2 names, 1 of them among the motion files found." in scan.notes


def test_two_ignore_lists(official: Any) -> None:
    official.names("ignore_list.txt", TRAIN)
    official.names("splits/ignore_list.txt", TEST)
    scan = AistPP().scan(official.root)
    assert rejects(scan, "ignored") == [TRAIN]
    assert "not used: splits/ignore_list.txt" in notes(scan)


def test_ignore_none(official: Any) -> None:
    scan = AistPP(ignore="none").scan(official.root)
    assert splits(scan)[IGNORED] == "train"
    assert "Ignore list: not applied, as requested." in scan.notes


def test_a_folder_of_lists_without_lists() -> None:
    with raises_message(UsageError, "split_dir"):
        AistPP(split="all", split_dir="x")

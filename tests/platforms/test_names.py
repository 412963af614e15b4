"""Names of files that not every system has, or tells apart."""

import re
from pathlib import Path, PureWindowsPath

import pytest

from dancedata.core import system
from dancedata.core.errors import UsageError
from dancedata.exports.base.folder import ExportFolder
from tests.messages import raises_message

REFUSED = ("con", "NUL.npy", "aux .x", "com1.txt", "a:b.npy", "a|b", "a?", "a*", "a.", "a ", "a\\b", 'a"b', "a\tb")
ALLOWED = ("console.npy", "a.b", ".hidden", "com.npy", "ドンス.npy", "a b", "nul_1")


@pytest.mark.filterwarnings("ignore:pathlib.PurePath.is_reserved:DeprecationWarning")  # os.path has it since 3.13
@pytest.mark.parametrize("name", [*REFUSED, *ALLOWED])
def test_names_that_windows_has_not(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "REMOVES_OPEN", True)
    assert system.why_no_file_name(name) == ""
    monkeypatch.setattr(system, "REMOVES_OPEN", False)
    assert bool(system.why_no_file_name(name)) == (name in REFUSED)
    # Python's own list, which has no rule for characters.
    if re.fullmatch(r"[\w. ]+", name) and not name.endswith((".", " ")):
        assert PureWindowsPath(name).is_reserved() == (name in REFUSED)


def test_no_file_of_an_export_is_another_thing_on_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "REMOVES_OPEN", False)
    with raises_message(UsageError):
        ExportFolder(tmp_path, tmp_path).write_text("motions/a:b.txt", "x")  # a stream of the file "a"
    assert list(tmp_path.iterdir()) == []


def test_names_that_differ_in_case_lose_no_file(tmp_path: Path) -> None:
    """As on macOS and Windows, where the second name finds the first file."""
    folder = ExportFolder(tmp_path, tmp_path)
    folder.write_text("Clip.txt", "first")
    if not (tmp_path / "clip.txt").exists():  # a system that tells them apart
        (tmp_path / "clip.txt").hardlink_to(tmp_path / "Clip.txt")
    with raises_message(UsageError):
        folder.write_text("clip.txt", "second")
    assert (tmp_path / "Clip.txt").read_text() == "first"

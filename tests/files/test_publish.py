"""Folders that appear whole: killed at any moment they are finished or restarted; foreign files are not touched."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from dancedata.core.errors import StoreError
from dancedata.files import publish
from dancedata.files.publish import MARKER, STAGING, Layout, staged, tidy
from tests.messages import raises_message

NAMES = ["a.bin", "b.bin", "last.json"]
LAYOUT = Layout("last.json", lambda path: path.read_text() == "last.json", lambda name: name in NAMES)
#: Simulates a kill: no clean-up runs.
KILL = RuntimeError("killed")


def write(out: Path, then: Callable[[], object] = lambda: None) -> None:
    tidy(out, LAYOUT)
    if (out / "last.json").exists():
        return
    with staged(out, LAYOUT) as folder:
        for name in NAMES:
            (folder / name).write_text(name)
        then()


def content(out: Path) -> dict[str, str]:
    return {str(p.relative_to(out)): p.read_text() for p in sorted(out.rglob("*")) if p.is_file()}


def test_it_appears_whole(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("somebody's")
    write(tmp_path)
    assert content(tmp_path) == {**{name: name for name in NAMES}, "notes.txt": "somebody's"}


def test_an_error_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        write(tmp_path, lambda: 1 / 0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("moment", range(8))
def test_killed_at_any_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: int) -> None:
    """Steps: the marker, then a.bin and so on as above, and every rename."""
    left = moment

    def dying(original):  # type: ignore[no-untyped-def]
        def call(*args):  # type: ignore[no-untyped-def]
            nonlocal left
            left -= 1
            if left < 0:
                raise KILL
            return original(*args)

        return call

    with monkeypatch.context() as killed:
        killed.setattr(publish, "discard", lambda *_: False)
        killed.setattr(os, "rename", dying(os.rename))
        killed.setattr(Path, "write_text", dying(Path.write_text))
        if moment < 7:
            with pytest.raises(RuntimeError, match="killed"):
                write(tmp_path)
            assert not (tmp_path / "last.json").exists()
    write(tmp_path)
    assert content(tmp_path) == {name: name for name in NAMES}
    assert sorted(os.listdir(tmp_path)) == NAMES


@pytest.mark.parametrize(
    ("name", "proofs"),
    [
        ("a.bin", ("none", "another")),
        ("last.json", ("none", "another")),
        ("notes.txt", ("none", "another", "ours")),
        (".dancedata-1.tmp", ("none", "another", "ours")),
        ("folder/a.bin", ("none", "another", "ours")),
    ],
)
def test_a_folder_of_our_name_with_foreign_files(tmp_path: Path, name: str, proofs: tuple[str, ...]) -> None:
    for proof in proofs:
        ours = tmp_path / proof / STAGING
        ours.parent.mkdir()
        if proof == "ours":
            publish.claim(ours)
        (ours / name).parent.mkdir(parents=True, exist_ok=True)
        (ours / name).write_text("somebody's")
        if proof == "another":
            (ours / MARKER).write_text("mine")
        before = content(ours)
        with raises_message(StoreError, "holds", where=".dancedata-unfinished") as caught:
            write(ours.parent)
        assert content(ours) == before
        assert name.partition("/")[0] in str(caught.value)


def test_a_last_file_of_our_name_that_is_not_whole(tmp_path: Path) -> None:
    (tmp_path / LAYOUT.journal).write_text("somebody's")
    with raises_message(StoreError, "holds"):
        write(tmp_path)
    assert (tmp_path / LAYOUT.journal).read_text() == "somebody's"


@pytest.mark.parametrize("name", ["a.bin", "last.json"])
def test_a_file_that_would_be_replaced(tmp_path: Path, name: str) -> None:
    with raises_message(StoreError, "holds"):
        write(tmp_path, lambda: (tmp_path / name).write_text("somebody's"))
    assert content(tmp_path) == {name: "somebody's"}


def test_a_file_that_came_after_the_last_one_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as killed:
        killed.setattr(publish, "_finish", lambda *_: None)
        write(tmp_path)
    (tmp_path / "b.bin").write_text("somebody's")
    for _ in range(2):
        with raises_message(StoreError, "holds"):
            write(tmp_path)
    assert (tmp_path / "b.bin").read_text() == "somebody's"
    (tmp_path / "b.bin").unlink()
    write(tmp_path)
    assert content(tmp_path) == {name: name for name in NAMES}


def test_leftovers_of_a_writer_killed_while_creating_the_folder(tmp_path: Path) -> None:
    (tmp_path / STAGING).mkdir()
    (tmp_path / STAGING / ".dancedata-abcd_123.tmp").write_text("")
    write(tmp_path)
    assert content(tmp_path) == {name: name for name in NAMES}

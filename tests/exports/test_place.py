"""An export appears whole or not at all, and foreign files are not touched."""

import errno
import json
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import dancedata
from dancedata.cli.app import app
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import self_hash
from dancedata.exports.npz import Npz
from dancedata.files import publish
from dancedata.files.atomic_folder import AtomicFolder, atomic_folder, read_about, remove_listed
from dancedata.files.publish import claim, mark
from tests.messages import raises_message


def tree(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def npz(built, tmp_path: Path) -> Callable[..., Any]:
    def run(out: str = "out", **options: Any) -> Any:
        return dancedata.export(built("edge").path, "npz", tmp_path / out, progress=False, **options)

    return run


def test_contents_of_export_json(npz, built) -> None:
    done = npz()
    about = json.loads((done.path / "export.json").read_text())
    assert about == done.about
    assert about["self_sha256"] == self_hash(about)
    assert about["dataset"]["self_sha256"] == built("edge").store.info["self_sha256"]
    sizes = {name: len(data) for name, data in tree(done.path).items() if name != "export.json"}
    assert {name: size for name, (size, _) in about["files"].items()} == sizes
    assert "research use, no redistribution" in (done.path / "LICENCE.txt").read_text()
    assert "research use, no redistribution" in (done.path / "README.md").read_text()


def test_an_export_is_replaced_only_with_overwrite(npz) -> None:
    first = tree(npz().path)
    with raises_message(StoreError, "already", where="out"):
        npz()
    assert tree(npz(overwrite=True, fields=["edge151"]).path).keys() == first.keys()
    assert tree(npz(overwrite=True).path) == first


@pytest.mark.parametrize(
    "change", ["added", "other size", "same size", "README.md", "a foreign folder", "a link", "a pipe"]
)
def test_changed_files_stay(npz, change: str, tmp_path: Path) -> None:
    out = npz().path
    files = {
        "added": "clips/mine.txt",
        "other size": "index.json",
        "same size": "index.json",
        "README.md": "README.md",
    }
    path = out / files.get(change, "mine")
    if change == "a foreign folder":
        path.mkdir()
        path = path / "file"
    if change == "a link":
        path.symlink_to(tmp_path)
    elif change == "a pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(path.read_bytes()[::-1] if change in ("README.md", "same size") else b"mine")
    before = tree(out)
    with raises_message(StoreError, "added", where="out"):
        npz(overwrite=True)
    assert tree(out) == before


@pytest.mark.parametrize("kind", ["file", "folder", "dataset", "forged"])
def test_foreign_folders_are_refused(npz, kind: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    if kind == "file":
        out.write_text("mine")
    else:
        out.mkdir()
        names = {"folder": "mine", "dataset": "dataset.json", "forged": "export.json"}
        (out / names[kind]).write_text('{"files": {}}')
    with raises_message(StoreError, "export", where="out"):
        npz(overwrite=True)
    assert out.read_text() == "mine" if kind == "file" else len(list(out.iterdir())) == 1


def test_an_empty_folder_is_taken(npz, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    assert read_about(npz().path)


@pytest.mark.parametrize("file", [0, 3, 6])
def test_a_full_disk_leaves_nothing(npz, tmp_path: Path, file: int, monkeypatch: pytest.MonkeyPatch) -> None:
    old = tree(npz("old").path)
    write, count = Path.write_bytes, iter(range(1000))

    def full(path: Path, data: bytes) -> int:
        if ".export-new-" in str(path) and "tmp" not in path.name and next(count) == file:
            write(path, bytes(data)[:100])
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(StoreError, match=r"cannot be written; found .*No space left.*nothing was left there"):
        npz("new/out")
    assert not (tmp_path / "new").exists()
    count = iter(range(1000))
    with pytest.raises(StoreError, match="No space left"):
        npz("old", overwrite=True)
    assert tree(tmp_path / "old") == old
    assert [p.name for p in tmp_path.iterdir()] == ["old"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_export_leaves_nothing(npz, tmp_path: Path, error: type, monkeypatch) -> None:
    def interrupted(self: Npz, job: Any, folder: AtomicFolder) -> None:
        folder.write_text("clips/a", "half")
        raise error

    monkeypatch.setattr(Npz, "write", interrupted)
    with pytest.raises(error):
        npz()
    assert not list(tmp_path.iterdir())


def test_the_next_export_removes_the_rest_of_a_killed_one(npz, tmp_path: Path) -> None:
    half = tmp_path / ".dancedata-out.export-new-01234567"
    claim(half)
    (half / "clips").mkdir()
    (half / "clips" / "a.npz").write_bytes(b"half")
    (tmp_path / ".dancedata-out.export-new-89abcdef").mkdir()  # killed before it wrote the marker
    saying = tmp_path / ".dancedata-out.export-new-fedcba98"
    saying.mkdir()
    (saying / ".dancedata-01234567.tmp").write_bytes(b"ha")  # killed while writing the marker
    foreign = tmp_path / ".dancedata-out.export-new-76543210"
    foreign.mkdir()
    (foreign / "mine").write_text("mine")
    other = tmp_path / ".dancedata-two.export-new-01234567"
    claim(other)
    npz()
    assert sorted(p.name for p in tmp_path.iterdir()) == [foreign.name, other.name, "out"]
    assert (foreign / "mine").exists()


def test_a_swap_that_was_killed_is_put_back(npz, tmp_path: Path) -> None:
    before = tree(npz().path)
    (tmp_path / "out").rename(tmp_path / ".dancedata-out.export-old-01234567")
    with raises_message(StoreError, "already", where="out"):
        npz()
    assert tree(tmp_path / "out") == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("which", ["new", "old"])
def test_a_removal_that_was_killed_is_finished(npz, tmp_path: Path, which: str, monkeypatch) -> None:
    """Its marker is removed last, and a half-removed folder is not restored as an export."""
    npz()
    rest = tmp_path / f".dancedata-out.export-{which}-01234567"
    (tmp_path / "out").rename(rest)
    if which == "new":
        (rest / "export.json").unlink()
        mark(rest)
    remove_listed(rest)
    assert not rest.exists()
    names = [*tree(npz().path), "dancedata-unfinished.json"]
    for killed_at in range(len(names)):
        shutil.rmtree(rest, ignore_errors=True)
        (tmp_path / "out").rename(rest)
        if which == "new":
            (rest / "export.json").unlink()
            mark(rest)
        count = iter(range(killed_at))
        unlink = os.unlink

        def killed(path: Any, *args: Any, unlink: Any = unlink, count: Any = count, **options: Any) -> None:
            if ".tmp" not in str(path) and next(count, None) is None:
                raise KeyboardInterrupt
            unlink(path, *args, **options)

        monkeypatch.setattr(os, "unlink", killed)
        with suppress(KeyboardInterrupt):
            remove_listed(rest)
        monkeypatch.setattr(os, "unlink", unlink)
        npz()
        assert [p.name for p in tmp_path.iterdir()] == ["out"], killed_at
        assert set(read_about(tmp_path / "out")["files"]) < set(tree(tmp_path / "out"))


def test_an_interrupt_while_a_folder_is_claimed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(folder: Path) -> None:
        mark(folder)
        raise KeyboardInterrupt

    monkeypatch.setattr(publish, "mark", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_folder(tmp_path / "out", overwrite=False):
        pass
    assert not list(tmp_path.iterdir())


def test_two_exports_at_once(tmp_path: Path) -> None:
    def second() -> None:
        with atomic_folder(tmp_path / "out", overwrite=False):
            pass

    with atomic_folder(tmp_path / "out", overwrite=False), raises_message(StoreError, "writing", where="out"):
        second()


def test_a_file_that_appears_during_the_export_is_not_replaced(tmp_path: Path) -> None:
    def fill() -> None:
        with atomic_folder(tmp_path / "out", overwrite=False) as folder:
            folder.write_text("a", "a")
            (tmp_path / "out").mkdir()
            (tmp_path / "out" / "mine").write_text("mine")

    with raises_message(StoreError, "output", where="out"):
        fill()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "mine").read_text() == "mine"


@pytest.mark.parametrize("name", ["", "/abs", "../up", "a/../../up", "nul\0"])
def test_paths_of_files_stay_below(tmp_path: Path, name: str) -> None:
    with raises_message(UsageError, "below"):
        AtomicFolder(tmp_path, tmp_path).write_text(name, "x")
    assert not list(tmp_path.iterdir())


def test_links_are_of_equal_bytes_only(tmp_path: Path) -> None:
    folder = AtomicFolder(tmp_path, tmp_path, link=True)
    for name, text in (("a", "x"), ("b", "x"), ("c", "y")):
        folder.write_text(name, text)
    assert os.stat(tmp_path / "a").st_ino == os.stat(tmp_path / "b").st_ino != os.stat(tmp_path / "c").st_ino
    assert folder.linked == 1


def test_a_name_given_twice_also_in_another_case_loses_no_file(tmp_path: Path) -> None:
    """As on macOS, where the second name finds the first file."""
    folder = AtomicFolder(tmp_path, tmp_path)
    folder.write_text("Clip.txt", "first")
    with raises_message(UsageError, "export"):
        folder.write_text("Clip.txt", "again")
    if not (tmp_path / "clip.txt").exists():  # a system that tells them apart
        (tmp_path / "clip.txt").hardlink_to(tmp_path / "Clip.txt")
    with pytest.raises(UsageError, match="upper from lower case"):
        folder.write_text("clip.txt", "second")
    assert (tmp_path / "Clip.txt").read_text() == "first"


def test_the_command(built, tmp_path: Path) -> None:
    made = built("edge")
    run = CliRunner().invoke
    arguments = ["export", str(made.path), "--to", "edge"]
    arguments += ["--out", str(tmp_path / "out"), "--music", str(made.source)]
    done = run(app, [*arguments, "--set", "val_as_test=true", "--set", "feature=librosa35", "--link", "--quiet"])
    assert done.exit_code == 0, done.output
    assert f"exported edge as edge to {tmp_path}/out: " in done.stdout
    assert "fewer than the trainer's batch of 64" in done.stdout
    again = run(app, arguments)
    assert again.exit_code == 1
    assert "error: " in again.stderr
    told = json.loads(run(app, [*arguments, "--overwrite", "--json"]).stdout)["result"]
    assert (told["target"], told["parameters"]["val_as_test"]) == ("edge", False)
    assert told["files"] > 20
    wrong = run(app, ["export", str(made.path), "--to", "edge", "--out", str(tmp_path / "x"), "--set", "speed=2"])
    assert wrong.exit_code == 2
    assert "export.edge.speed: unknown key" in wrong.stderr

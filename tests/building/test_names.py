"""File names of any bytes, and control characters in names and files: set aside by name, never printed raw."""

import json
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.building.build import build
from dancedata.cli.app import main
from dancedata.core.clip import Scan
from dancedata.core.errors import DataError
from dancedata.datasets.folder import Folder
from dancedata.recipes.parse import load_recipe
from tests.messages import raises_message

RECIPE = """recipe: 1
name: mine
dataset: {folder: {unit: m, up: y, fps: 30, music: optional}}
windows: {length_s: 2, stride_s: 1}
motion: {edge151: {}}
"""
#: Names as in old archives, or made to do harm; and as shown.
NAMES = {
    b"caf\xe9": r"caf\udce9", b"\xed\xa0\x80": r"\udced\udca0\udc80", b"red\x1b[31m": r"red\x1b[31m",
    b"new\nline": r"new\nline", "back\u202ewards".encode(): r"back\u202ewards",
}  # fmt: skip
Source = Callable[[bytes], Path]
Run = Callable[..., str]


@pytest.fixture
def make_source(tmp_path: Path) -> Source:
    """Return a function that makes a source of one good clip, in a folder of this name."""

    def made(name: bytes = b"source") -> Path:
        folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + name))
        Folder().make_example(folder)
        (folder / "manifest.csv").unlink()
        for path in (folder / "motions").iterdir():
            if path.name != "smpl.npz":
                path.unlink()
        return folder

    return made


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    (tmp_path / "mine.yaml").write_text(RECIPE)
    return tmp_path / "mine.yaml"


def beside(path: Path, name: bytes) -> Path:
    """A path in the same folder, of any bytes."""
    return Path(os.fsdecode(os.fsencode(path.parent) + b"/" + name))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsysbinary: pytest.CaptureFixture[bytes]) -> Run:
    """Return a function that runs the command; its output has to be UTF-8 without control characters."""

    def ran(*arguments: Any, fails: bool = False) -> str:
        monkeypatch.setattr(sys, "argv", ["dancedata", *map(str, arguments)])
        sys.stderr.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]  # as Python opens it
        with pytest.raises(SystemExit) as ended:
            main()
        text = b"".join(capsysbinary.readouterr()).decode()
        assert bool(ended.value.code) is fails, text
        assert all(c.isprintable() or c == "\n" for c in text), ascii(text)
        return text

    return ran


def test_names_that_are_not_text_are_rejected(run, make_source, recipe, out, rejects):
    source = make_source(b"source")
    good = source / "motions" / "smpl.npz"
    for name in NAMES:
        shutil.copy(good, beside(good, name + b".npz"))
        shutil.copy(source / "music" / "fast.wav", beside(source / "music" / "x", name + b".wav"))
    beside(good, b"\xffolder").mkdir()
    beside(source / "x", b"note\xff.txt").touch()
    text = run("build", recipe, source, "--out", out, "--jobs", 1)
    with dancedata.open(out) as ds:
        assert [clip.id for clip in ds] == ["smpl"]
    found = {(r["reason"], r.get("clip"), r.get("file")) for r in rejects(out)}
    assert {f for f in found if f[0] != "unused_music"} == {
        *(("bad_name", name, f"motions/{name}.npz") for name in NAMES.values()),
        ("extra_file", None, r"motions/\udcffolder"),
        ("extra_file", None, r"note\udcff.txt"),
    }
    assert r"bad_name: 5 (" in text
    # A second run knows it all, and the other commands show it.
    assert "nothing to do" in run("build", recipe, source, "--out", out, "--jobs", 1)
    for path in (out, source):
        run("check", path, *(() if path == out else ("--recipe", recipe)), fails=path == source)
    assert json.loads(run("info", out, "--json"))["result"]["rejects"]["bad_name"] == 5
    strict = run("build", recipe, source, "--out", out.parent / "strict", "--strict", fails=True)
    assert "5 broken clips" in strict


@pytest.mark.parametrize("jobs", [pytest.param(1, marks=pytest.mark.nightly), 2])
def test_folders_whose_names_are_not_text(run, make_source, recipe, tmp_path, jobs):
    """The source, the output and the cache; and the same bytes as from a source with a plain name."""
    source = make_source(b"so\xffurce")
    out, cache = beside(tmp_path / "x", b"o\xffut"), beside(tmp_path / "x", b"c\xffache")
    common = ("--cache", cache, "--jobs", jobs)
    text = run("build", recipe, source, "--out", out, *common)
    assert r"so\udcffurce" in text
    assert r"o\udcffut" in run("info", out, "--clips")
    run("build", "--dry-run", recipe, source, "--cache", cache)
    run("cache", "--cache", cache)
    plain = shutil.copytree(source, tmp_path / "plain")
    run("build", recipe, plain, "--out", tmp_path / "out", *common)
    assert "the same data" in run("check", out, "--same-as", tmp_path / "out")


def test_control_characters_in_lists_of_names(run: Run, corpus: Path, tmp_path: Path, out: Path) -> None:
    source = shutil.copytree(corpus, tmp_path / "source")
    for path in (source / "splits").iterdir():
        path.unlink()
    names = sorted(path.stem for path in (source / "motions").iterdir())
    train = "\n".join([*names, "\x1b[2J\x07", "gone\x9b1m"])
    (source / "splits" / "crossmodal_train.txt").write_text(train, encoding="utf-8")
    text = run("build", "aist++", source, "--out", out, "--set", "audio={}", "--jobs", 1)
    assert r"\x1b[2J\x07" in text
    run("info", out)
    run("check", source, "--recipe", "aist++")
    (source / "splits" / "crossmodal_val.txt").write_text("gone\x9b1m", encoding="utf-8")
    text = run("build", "aist++", source, "--out", out.parent / "two", fails=True)
    assert r"sequence gone\x9b1m is in two splits" in text


def test_clips_of_a_plug_in_with_invalid_texts(make_source, recipe, out, rejects, monkeypatch):
    """A reader that passes on what it finds: no clip of it reaches the store, the others do."""
    scan = Folder.scan

    def scanned(self: Folder, source: Path) -> Scan:
        found = scan(self, source)
        (good,) = found.clips
        more = [replace(good, id="a\udcff"), replace(good, id="b", genre="\ud800"), replace(
            good, id="c", lists=("\udcff",),
        )]  # fmt: skip
        return replace(found, clips=(*more, good))

    monkeypatch.setattr(Folder, "scan", scanned)
    source = make_source(b"source")
    build(load_recipe(recipe), source, out)
    with dancedata.open(out) as ds:
        assert [clip.id for clip in ds] == ["smpl"]
    assert {r["clip"] for r in rejects(out) if r["reason"] == "bad_name"} == {r"a\udcff", "b", "c"}
    with raises_message(DataError, "bad_name", reason="bad_name"):
        build(load_recipe(recipe), source, out.parent / "strict", strict=True)

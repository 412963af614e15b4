"""Shared by the readers: their files, the folder of a dataset, the choice of audio files, .npy headers."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
import yaml

import dancedata
from dancedata.core.bodies import SMPLX55
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.resources import resource
from dancedata.datasets.aistpp import AistPP
from dancedata.datasets.files import audio_files, files_by_stem, require_choices
from dancedata.datasets.finedance import FineDance, load_motion, motion_length
from dancedata.datasets.folder import Folder
from dancedata.datasets.published import Layout
from dancedata.formats import arrays
from tests.messages import raises_message

PACKAGE = Path(dancedata.__file__).parent


@pytest.mark.parametrize("name", [name for name in DATASETS.names() if name != "synthetic"])
def test_every_reader_shows_its_tree(name: str) -> None:
    reader = DATASETS.get(name).__module__.removesuffix(".reader")
    text = str(importlib.import_module(reader).__doc__)
    assert "    SOURCE/" in text


@pytest.mark.parametrize(("name", "reader"), [("aist++", AistPP), ("finedance", FineDance), ("folder", Folder)])
def test_registered_and_described(name: str, reader: type[Dataset]) -> None:
    assert DATASETS.get(name) is reader
    if reader is not Folder:
        text = resource("manifests", f"{name.replace('+', 'p')}.yaml").read_text(encoding="utf-8")
        manifest = yaml.safe_load(text)
        assert (reader.licence, reader.citation) == (manifest["licence"], manifest["citation"])


@pytest.mark.parametrize("reader", [AistPP, FineDance, Folder])
def test_folders_that_are_not_a_source(tmp_path: Path, reader: type[Dataset]) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / ".DS_Store").write_text("x")
    for name in ("no where", "file", "empty"):
        with raises_message(SourceError, "source"):
            reader().scan(tmp_path / name)


def test_one_parser_of_npy_headers() -> None:
    calls = ("read_magic", "read_array_header", "lib.format.read_array(", "np.load(")
    # Templates of `dancedata init` become the code of users.
    files = [path for path in PACKAGE.rglob("*.py") if "templates" not in path.parts]
    using = {path.relative_to(PACKAGE).as_posix() for path in files if any(c in path.read_text() for c in calls)}
    # The README that `export --to npz` writes shows a line for each reader.
    assert using == {"formats/arrays.py", "exports/npz.py"}


def test_a_finedance_file_above_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "001.npy", np.zeros((5, 315), np.float32))
    assert motion_length(tmp_path / "001.npy") == 5
    monkeypatch.setattr(arrays, "MAX_ARRAY_BYTES", 1000)
    with raises_message(DataError, "limit", where="001.npy", reason="too_large"):
        load_motion(tmp_path / "001.npy", SMPLX55)
    assert motion_length(tmp_path / "001.npy") is None


def test_the_root_is_the_source_or_one_folder_in_it(tmp_path: Path) -> None:
    def root(known: str = "") -> tuple[str, list[str]]:
        folders = Layout("x", "X", "motion", ".npy", "NAME.npy", folder_names=(known,) if known else ()).find(
            tmp_path
        )
        return folders.root.name, [path.name for path in folders.others]

    (tmp_path / "a").mkdir()
    with raises_message(SourceError, "contains"):
        root()
    (tmp_path / "a" / "motion").mkdir()
    assert root() == ("a", [])
    (tmp_path / "b" / "motion").mkdir(parents=True)
    with raises_message(SourceError, "folders"):
        root()
    assert root("b") == ("b", ["a"])
    (tmp_path / "motion").mkdir()
    assert root("b") == (tmp_path.name, [])


def test_audio_by_format_then_by_folder(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("one/a.mp3", "one/b.WAV", "two/a.flac", "two/b.wav", "two/c.ogg")]
    found = audio_files(paths, tmp_path, [])
    assert {stem: path.parent.name for stem, path in found.files.items()} == {"a": "two", "b": "one", "c": "two"}
    assert [(r.reason, r.file, r.detail) for r in found.rejects] == [
        ("unused_music", "one/a.mp3", "two/a.flac is used instead"),
        ("unused_music", "two/b.wav", "one/b.WAV is used instead"),
    ]
    (note,) = found.notes
    assert "for 2 of the names" in note


def test_the_published_spelling_of_a_suffix_first(tmp_path: Path) -> None:
    for name in ("a.NPY", "a.npy", "b.NPY", "no.npy", "c.txt"):
        (tmp_path / name).touch()
    found = files_by_stem(tmp_path, tmp_path, ".npy", lambda stem: "not a name" if stem == "no" else "")
    assert {stem: path.name for stem, path in found.files.items()} == {"a": "a.npy", "b": "b.NPY"}
    assert {r.file: r.detail for r in found.rejects} == {
        "a.NPY": "the same name as a.npy, which is read",
        "no.npy": "not a name",
        "c.txt": "not a .npy file",
    }


@dataclass
class Chosen:
    name: ClassVar[str] = "x"
    split: Literal["all", "none"] = "all"


def test_an_invalid_value_names_the_closest() -> None:
    require_choices(Chosen())  # type: ignore[arg-type]
    with raises_message(UsageError, "split"):
        require_choices(Chosen("non"))  # type: ignore[arg-type]

"""Examples in docstrings are run, on a tiny dataset, and print what they show."""

import doctest
import importlib
import inspect
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import dancedata
from tests.groups_store import write_groups

MODULES = ("torch", "metrics", "core.grid", "core.motion", "core.skeleton", "core.rotations", "store", "keymotion")
MODULES += ("synthetic", "testing.examples", "testing.stores", "testing.conformance")


def public_objects() -> Iterator[tuple[str, object]]:
    """Yield the public functions, classes and their methods, each once, with the address of its definition."""
    seen = set()
    for module in (dancedata, *(importlib.import_module(f"dancedata.{name}") for name in MODULES)):
        names = getattr(module, "__all__", None) or [n for n in vars(module) if not n.startswith("_")]
        for value in (getattr(module, name) for name in names):
            if not (inspect.isfunction(value) or inspect.isclass(value)) or value in seen:
                continue
            seen.add(value)
            if value.__module__.startswith("dancedata."):
                yield f"{value.__module__}.{value.__qualname__}", value
                for name, method in vars(value).items() if inspect.isclass(value) else ():
                    if not name.startswith("_") and inspect.isfunction(method):
                        yield f"{value.__module__}.{method.__qualname__}", method


@pytest.fixture(scope="module")
def doc_files(built: Path, corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder and home with the files that the examples name."""
    folder = tmp_path_factory.mktemp("docstrings")
    for name in ("aistpp", "the-same-again"):
        shutil.copytree(built, folder / "data" / name)
    write_groups(folder / "data" / "groups")
    (folder / "aist_plusplus_final").symlink_to(corpus)
    shutil.copy(sorted((corpus / "wavs").iterdir())[0], folder / "song.wav")
    with dancedata.open(built) as ds:
        rows = np.stack([ds.read(window, "edge151") for window in ds.windows("train")[:2]])
        np.save(folder / "samples.npy", ds.scaler("edge151").normalize(rows))
    return folder


def examples(value: object) -> list[doctest.Example]:
    return doctest.DocTestParser().get_examples(inspect.getdoc(value) or "")


OBJECTS = {name: value for name, value in public_objects() if examples(value)}


def test_headings_of_sections_are_lines_of_their_own() -> None:
    """A tool that fills paragraphs joins "Notes" and its dashes to the text."""
    files = sorted(Path(dancedata.__file__).parent.rglob("*.py"))
    assert [file for file in files if re.search(r"^ *[A-Z]\w+ -{3,}", file.read_text(), re.MULTILINE)] == []


def test_examples_exist_and_show_output() -> None:
    assert len([value for value in OBJECTS.values() if any(example.want for example in examples(value))]) >= 25


@pytest.mark.parametrize("name", OBJECTS)
def test_examples(name: str, doc_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(doc_files)
    monkeypatch.setenv("HOME", str(doc_files))
    text = inspect.getdoc(OBJECTS[name]) or ""
    test = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    printed: list[str] = []
    runner.run(test, out=printed.append)
    assert not runner.failures, "".join(printed)

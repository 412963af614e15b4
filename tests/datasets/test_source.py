"""Shared by the readers: the folder of a dataset, its files, special ones, and names that no file should have."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from dancedata.core.errors import DataError, RecipeError, SourceError
from dancedata.core.registry import DATASETS
from dancedata.core.text import listed
from dancedata.datasets.files import files_by_stem, list_audio, read_names
from dancedata.datasets.finedance import read_genre
from dancedata.datasets.folder import Folder
from dancedata.datasets.folder.manifest import read_manifest
from dancedata.datasets.published import Layout, LeftOut
from dancedata.formats.bvh.parse import read_bvh_header
from dancedata.formats.values import open_arrays
from dancedata.recipes.parse import load_recipe
from tests.messages import raises_message


@pytest.mark.parametrize("name", [name for name in DATASETS.names() if name not in ("folder", "synthetic")])
def test_every_dataset_shows_its_tree(name: str) -> None:
    page = Path(__file__).parents[2] / "docs" / "datasets" / f"{name.replace('++', 'pp')}.md"
    assert "\n```\nSOURCE/" in page.read_text("utf-8")


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
    for name in ("one/a.mp3", "one/b.WAV", "two/a.flac", "two/b.wav", "two/c.ogg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = list_audio([tmp_path / "one", tmp_path / "two"], tmp_path, lambda stem: "")
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


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_a_pipe_for_anything_else(pipe: Path) -> None:
    with pytest.raises(LeftOut, match="named pipe"):
        read_genre(pipe, "001")
    for read in (read_names, read_manifest):
        with raises_message(SourceError, "UTF-8", where="pipe"):
            read(pipe)
    with raises_message(RecipeError, "regular", where="pipe.yaml"):
        load_recipe(pipe.rename(pipe.with_suffix(".yaml")))
    os.mkfifo(pipe.with_suffix(".npz"))
    with raises_message(DataError, "copy", where="pipe.npz", reason="broken_file"):
        open_arrays(pipe.with_suffix(".npz")).__enter__()


def test_pipes_in_a_folder(example: Callable[[str], Path]) -> None:
    tmp_path = example("folder")
    (tmp_path / "manifest.csv").unlink()
    os.mkfifo(tmp_path / "motions" / "pipe.npz")
    os.mkfifo(tmp_path / "music" / "pipe.wav")
    (tmp_path / "motions" / "nowhere.npz").symlink_to("gone")
    scan = Folder(music="optional").scan(tmp_path)
    found = {r.file: r.detail for r in scan.rejects if "not a file" in r.detail}
    assert set(found) == {"motions/pipe.npz", "music/pipe.wav", "motions/nowhere.npz"}
    os.mkfifo(tmp_path / "manifest.csv")
    with raises_message(SourceError, "UTF-8", where="manifest.csv"):
        Folder().scan(tmp_path)
    (tmp_path / "manifest.csv").unlink()
    (tmp_path / "manifest.csv").write_text("motion,audio\nmotions/pipe.npz,\nmotions/smpl.npz,music/pipe.wav\n")
    scan = Folder().scan(tmp_path)
    assert [r.reason for r in scan.rejects if "not a file" in r.detail] == ["missing_motion", "missing_music"]


@pytest.mark.parametrize("text", ["x" * 256, "y\n" * 100_001, "z" * (1 << 23) + "\n" + "z" * 10])
def test_invalid_lists(tmp_path: Path, text: str) -> None:
    (tmp_path / "x_train.txt").write_text(text)
    with raises_message(SourceError, "UTF-8", where="x_train.txt") as error:
        read_names(tmp_path / "x_train.txt")
    assert len(str(error.value)) < 600
    (tmp_path / "a.txt").write_text("\n".join(["x" * 255, *(str(k) for k in range(99_999))]))
    assert len(read_names(tmp_path / "a.txt")) == 100_000


def test_a_joint_whose_name_is_too_long(tmp_path: Path) -> None:
    (tmp_path / "a.bvh").write_text("HIERARCHY\nROOT " + "x" * 10**6 + "\n{\n")
    with raises_message(DataError, "characters", where="a.bvh, line 2", reason="broken_file") as error:
        read_bvh_header(tmp_path / "a.bvh")
    assert len(str(error.value)) < 500


def test_names_in_a_message_are_cut_and_print() -> None:
    assert listed(["a\x1b", "b" * 999, "c", "d"], 3) == rf"a\x1b, {'b' * 255}..., c and 1 more"

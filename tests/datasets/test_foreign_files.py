"""Special files in a source folder, and names that no file should have."""

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.bodies import SMPLX55
from dancedata.core.errors import DataError, RecipeError, SourceError
from dancedata.core.text import listed
from dancedata.datasets.aistpp import AistPP
from dancedata.datasets.files import read_names
from dancedata.datasets.finedance import length_note, motion_length, read_genre
from dancedata.datasets.finedance import load_motion as load_finedance
from dancedata.datasets.folder import Folder
from dancedata.datasets.folder.manifest import read_manifest
from dancedata.datasets.published import LeftOut
from dancedata.formats.bvh.parse import read_bvh_header
from dancedata.formats.values import open_arrays
from dancedata.recipes.parse import load_recipe
from tests.datasets.scans import load
from tests.messages import raises_message


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def read_array(path: Path) -> None:
    with open_arrays(path) as arrays:
        arrays.read("")


@pytest.mark.parametrize(
    ("suffix", "read"),
    [
        (".pkl", read_array), (".npz", read_array), (".npy", read_array), (".bvh", read_bvh_header),
        (".pkl", lambda path: load(AistPP(), path)), (".npy", lambda path: load_finedance(path, SMPLX55)),
    ],
)  # fmt: skip
def test_a_pipe_for_a_motion(pipe: Path, suffix: str, read: Callable[[Path], Any]) -> None:
    path = pipe.rename(pipe.with_suffix(suffix))
    with raises_message(DataError, "copy|regular", reason="broken_file"):
        read(path)


def test_a_pipe_for_anything_else(pipe: Path) -> None:
    assert motion_length(pipe) is None
    assert length_note(pipe, pipe) == ""
    with pytest.raises(LeftOut, match="named pipe"):
        read_genre(pipe, "001")
    for read in (read_names, read_manifest):
        with raises_message(SourceError, "UTF-8", where="pipe"):
            read(pipe)
    with raises_message(RecipeError, "regular", where="pipe.yaml"):
        load_recipe(pipe.rename(pipe.with_suffix(".yaml")))


def test_pipes_in_a_folder(tmp_path: Path) -> None:
    Folder().make_example(tmp_path)
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


def test_pipes_that_a_manifest_names(tmp_path: Path) -> None:
    Folder().make_example(tmp_path)
    os.mkfifo(tmp_path / "a.npz")
    os.mkfifo(tmp_path / "a.wav")
    (tmp_path / "manifest.csv").write_text("motion,audio\na.npz,\nmotions/smpl.npz,a.wav\n")
    scan = Folder().scan(tmp_path)
    assert [(r.reason, "not a file" in r.detail) for r in scan.rejects] == [
        ("missing_motion", True),
        ("missing_music", True),
    ]


@pytest.mark.parametrize("text", ["x" * 256, "y\n" * 100_001, "z" * (1 << 23) + "\n" + "z" * 10])
def test_invalid_lists(tmp_path: Path, text: str) -> None:
    (tmp_path / "x_train.txt").write_text(text)
    with raises_message(SourceError, "UTF-8", where="x_train.txt") as error:
        read_names(tmp_path / "x_train.txt")
    assert len(str(error.value)) < 600


def test_lists_at_the_bounds(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("\n".join(["x" * 255, *(str(k) for k in range(99_999))]))
    assert len(read_names(tmp_path / "a.txt")) == 100_000


def test_a_joint_whose_name_is_too_long(tmp_path: Path) -> None:
    (tmp_path / "a.bvh").write_text("HIERARCHY\nROOT " + "x" * 10**6 + "\n{\n")
    with raises_message(DataError, "characters", where="a.bvh, line 2", reason="broken_file") as error:
        read_bvh_header(tmp_path / "a.bvh")
    assert len(str(error.value)) < 500


def test_lists_within_lists_are_not_unfolded(tmp_path: Path) -> None:
    rows: Any = [[0.0] * 72] * 4
    good = {"smpl_trans": np.zeros((4, 3)), "smpl_scaling": [np.float32(90)]}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"smpl_poses": rows, **good}))
    with raises_message(DataError, "floats", where="a.pkl, smpl_poses", reason="bad_shape"):
        load(AistPP(), tmp_path / "a.pkl")
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"smpl_poses": np.array(rows), **good}))
    assert load(AistPP(), tmp_path / "a.pkl").n_frames == 4


def test_names_in_a_message_are_cut_and_print() -> None:
    assert listed(["a\x1b", "b" * 999, "c", "d"], 3) == rf"a\x1b, {'b' * 255}..., c and 1 more"

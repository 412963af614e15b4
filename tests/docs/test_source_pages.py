"""The guides on own captures and on what goes wrong: their commands run on files as the pages describe them."""

import ast
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import dancedata
from dancedata.cli.app import app
from dancedata.datasets.folder import Folder
from dancedata.synthetic import write_synthetic
from tests.docs.pages import blocks
from tests.video_files import dance, gvhmr, in_camera, joblib_bytes, phalp, torch_file, wham, wham_person

N = 170
CAPTURES = "guides/own-captures.md"


def commands(page: str) -> list[tuple[list[str], int]]:
    """Return the arguments of a page's commands, and the exit code that its comment gives."""
    lines = "".join(blocks(f"docs/{page}", "sh")).splitlines()
    assert all(line.startswith("dancedata ") for line in lines)
    return [(line.partition("#")[0].split()[1:], 1 if "exit code 1" in line else 0) for line in lines]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[str]]:
    """Run the commands of a page in the test's folder, except `info`, which has its own tests."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "cache"))

    def run_page(page: str) -> list[str]:
        printed = []
        for arguments, code in commands(page):
            if arguments[0] != "doctor":
                result = CliRunner().invoke(app, arguments)
                assert result.exit_code == code, (arguments, result.output)
                printed.append(result.stdout)
        return printed

    return run_page


def pair(folder: Path, example: Path, **motions: bytes) -> None:
    """Put motion files and a song for each into a folder."""
    song = next((example / "music").iterdir())
    for part in ("motions", "music"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, data in motions.items():
        stem, _, suffix = name.rpartition("_")
        (folder / "motions" / f"{stem}.{suffix}").write_bytes(data)
        shutil.copy(song, folder / "music" / f"{stem}{song.suffix}")


@pytest.fixture
def example(tmp_path: Path) -> Path:
    Folder().make_example(tmp_path / "example")
    return tmp_path / "example"


def test_the_page_on_video(tmp_path: Path, example: Path, run: Callable[[str], list[str]]) -> None:
    two = {0: wham_person(N, seed=1, vertices=4), 1: wham_person(N - 20, 12, 2, vertices=4)}
    files: dict[str, Any] = {"anna_pkl": wham(two), "ben_pkl": phalp({1: (*dance(N, 3), np.arange(N))})}
    pair(tmp_path / "my-videos", example, **files, carla_pt=torch_file(gvhmr(N)))
    rotations, transl = dance(N, 5)
    half_turn = Rotation.from_rotvec((np.pi, 0, 0))  # to a camera's axes
    rotations[:, 0] = (half_turn * Rotation.from_rotvec(rotations[:, 0])).as_rotvec()
    hybrik = {"pred_thetas": rotations.reshape(N, 72), "transl": in_camera(transl)}
    pair(tmp_path / "hybrik-videos", example, res_pk=joblib_bytes(hybrik))
    recipes = blocks(f"docs/{CAPTURES}", "yaml")
    for name, recipe in zip(("recipe.yaml", "hybrik.yaml"), recipes, strict=True):
        (tmp_path / name).write_text(recipe)
    run(CAPTURES)
    with dancedata.open(tmp_path / "data" / "videos") as ds:
        assert [c.id for c in ds] == ["anna-person0", "anna-person1", "ben-person1", "carla"]
    with dancedata.open(tmp_path / "data" / "hybrik") as ds:
        assert [c.id for c in ds] == ["res"]


def test_the_script_of_blender_is_python() -> None:
    (script,) = (block for block in blocks(f"docs/{CAPTURES}", "python") if "import bpy" in block)
    ast.parse(script)  # Blender has its own Python


def test_the_page_on_what_is_wrong(tmp_path: Path, run: Callable[[str], list[str]]) -> None:
    source = write_synthetic(tmp_path / "SOURCE", songs=2, clips_per_song=4, clip_s=6)
    (source / "wavs" / "mBR0.wav").rename(source / "wavs" / "mbr0.wav")
    output = run("guides/when-something-is-wrong.md")
    (message,) = (b for b in blocks("docs/guides/when-something-is-wrong.md", "text") if b.startswith("error:"))
    assert message.strip().replace("\n  ", " ") in output[0].splitlines()

"""The guides on own captures and on what goes wrong: their commands run on files as the pages describe them."""

import ast
import json
import os
import re
import shlex
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import dancedata
from dancedata.cli.app import app
from dancedata.datasets.finedance import FineDance
from dancedata.datasets.folder import Folder
from dancedata.synthetic import write_synthetic
from tests import warm
from tests.docs.pages import blocks, blocks_of, text_of
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
                jobs = ["--jobs", "1"] if arguments[0] == "build" else []  # workers would import all of it again
                result = CliRunner().invoke(app, [*arguments, *jobs])
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


# The tutorial "Run EDGE or Lodge": its commands run, and the trainers' commands are those of the exports.


EDGE, LODGE = text_of("docs/tutorials/run-edge-or-lodge.md").split("## Lodge on FineDance")


def _of_trainer(text: str, folder: str) -> list[str]:
    """Return the lines of the page that call a trainer on an export."""
    lines = [line for block in blocks_of(text, "") for line in block.splitlines()]
    return [line for line in lines if "train.py" in line and f"{folder}/" in line]


def run_page(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Run a page's commands in this process, as separate ones take longer than the work; return what they print."""
    (commands,) = blocks_of(page, "sh")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("DANCEDATA_CACHE", str(folder / "cache"))
    printed = []
    for line in commands.splitlines():
        name, *words = shlex.split(line.replace("~", str(folder)))
        assert name == "dancedata"
        done = CliRunner().invoke(app, [*words, *(["--jobs", "1"] if words[0] == "build" else [])])
        assert done.exit_code == 0, done.output
        printed.append(done.output)
    return printed


def test_edge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_synthetic(tmp_path / "aist_plusplus_final", songs=3, clips_per_song=2, clip_s=5.5)
    run_page(EDGE, tmp_path, monkeypatch)
    export = tmp_path / "exports" / "edge"
    assert json.loads((export / "export.json").read_text())["target"] == "edge"
    names = {f: {path.stem for path in (export / "train" / f).iterdir()} for f in ("motions_sliced", "wavs_sliced")}
    assert names["motions_sliced"] == names["wavs_sliced"] != set()
    (line,) = _of_trainer(EDGE, "exports/edge")
    guide = (export / "README.md").read_text()
    assert line.replace("~", str(tmp_path)).replace("new/", "NEW_FOLDER/") in guide


@pytest.mark.nightly
def test_lodge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    FineDance().make_example(tmp_path / "finedance")
    assert "Lodge's loader" in "".join(run_page(LODGE, tmp_path, monkeypatch))  # what it will miss of the 202 tracks
    export = tmp_path / "exports" / "lodge"
    assert {path.name for path in export.iterdir()} >= {"assets.yaml", "Normalizer.pth", "finedance"}
    guide = (export / "README.md").read_text()
    lines = _of_trainer(LODGE, "exports/lodge")
    assert len(lines) == 2
    assert [line for line in lines if line.replace("~", str(tmp_path)) not in guide] == []
    (link,) = (line for line in LODGE.splitlines() if line.startswith("mkdir"))
    assert link in guide


# The commands of docs/guides/beyond-one-machine.md build the same bytes; clusters are in tests/fault.


SECTION = text_of("docs/guides/beyond-one-machine.md").split("## The same build everywhere")[1].split("\n## ")[0]


BUILDS = re.findall(r"^dancedata build .*", SECTION, flags=re.MULTILINE)


def run_line(line: str, corpus: Path, out: Path, environment: Mapping[str, str], number: str = "") -> Path:
    """Run a command of the page with the names of this machine; returns OUT."""
    names = {
        "/scratch/finedance": str(corpus), "/scratch/data/finedance": str(out), "build finedance": "build aist++",
        "--jobs 8": "--jobs 2", "$SLURM_ARRAY_TASK_ID/16": f"{number}/2",
    }  # fmt: skip
    for name, here in names.items():
        assert line.count(name) <= 1
        line = line.replace(name, here)
    done = warm.run(["python", "-m", *line.split()], environment)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Return an environment with a separate cache."""
    return {**os.environ, "DANCEDATA_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(Path.cwd())}


def test_the_page_has_every_way() -> None:
    assert len(re.findall(r"^```sh$", SECTION, flags=re.MULTILINE)) == 5
    clusters = [re.findall(r"--cluster (\w+)", line) for line in BUILDS]
    assert sorted(clusters) == [[], [], [], ["ray"], ["tcp"]]


def test_one_machine_and_an_array_build_the_same(corpus, built, tmp_path, environment, hashes):
    alone, part, collect = (line for line in BUILDS if "--cluster" not in line)
    assert hashes(run_line(alone, corpus, tmp_path / "alone", environment)) == hashes(built)
    environment["DANCEDATA_CACHE"] = str(tmp_path / "shared")
    assert "--array=1-16" in SECTION
    for number in "12":
        run_line(part, corpus, tmp_path / "no", environment, number)
    assert not (tmp_path / "no").exists()
    assert hashes(run_line(collect, corpus, tmp_path / "array", environment)) == hashes(built)

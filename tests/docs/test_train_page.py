"""The tutorial "Run EDGE or Lodge": its commands run, and the trainers' commands are those of the exports."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from dancedata.cli.app import app
from dancedata.datasets.finedance import FineDance
from dancedata.synthetic import write_synthetic
from tests.docs.pages import ROOT, blocks_of, text_of

EDGE, LODGE = text_of("docs/tutorials/run-edge-or-lodge.md").split("## Lodge on FineDance")


def _run(commands: str, folder: Path) -> str:
    """Run a block of the page as a shell does, in a home folder with the sources."""
    shell = f'set -eu; dancedata() {{ "{sys.executable}" -m dancedata "$@"; }}\n{commands}'
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "HOME": str(folder), "PYTHONPATH": paths, "DANCEDATA_CACHE": str(folder / "cache")}
    done = subprocess.run(["bash", "-c", shell], env=environment, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def _of_trainer(text: str, folder: str) -> list[str]:
    """Return the lines of the page that call a trainer on an export."""
    lines = [line for block in blocks_of(text, "") for line in block.splitlines()]
    return [line for line in lines if "train.py" in line and f"{folder}/" in line]


def test_edge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_synthetic(tmp_path / "aist_plusplus_final", songs=3, clips_per_song=2, clip_s=5.5)
    (commands,) = blocks_of(EDGE, "sh")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "cache"))
    for line in commands.splitlines():  # in this process: four processes take longer than the work
        name, *words = shlex.split(line.replace("~", str(tmp_path)))
        assert name == "dancedata"
        done = CliRunner().invoke(app, [*words, *(["--jobs", "1"] if words[0] == "build" else [])])
        assert done.exit_code == 0, done.output
    export = tmp_path / "exports" / "edge"
    assert json.loads((export / "export.json").read_text())["target"] == "edge"
    names = {f: {path.stem for path in (export / "train" / f).iterdir()} for f in ("motions_sliced", "wavs_sliced")}
    assert names["motions_sliced"] == names["wavs_sliced"] != set()
    (line,) = _of_trainer(EDGE, "exports/edge")
    guide = (export / "README.md").read_text()
    assert line.replace("~", str(tmp_path)).replace("new/", "NEW_FOLDER/") in guide


@pytest.mark.nightly  # in a shell, as a reader runs them
def test_lodge(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    FineDance().make_example(tmp_path / "finedance")
    (commands,) = blocks_of(LODGE, "sh")
    printed = _run(commands, tmp_path)
    assert "Lodge's loader" in printed  # what it will miss of the 202 tracks
    export = tmp_path / "exports" / "lodge"
    assert {path.name for path in export.iterdir()} >= {"assets.yaml", "Normalizer.pth", "finedance"}
    guide = (export / "README.md").read_text()
    lines = _of_trainer(LODGE, "exports/lodge")
    assert len(lines) == 2
    assert [line for line in lines if line.replace("~", str(tmp_path)) not in guide] == []
    (link,) = (line for line in LODGE.splitlines() if line.startswith("mkdir"))
    assert link in guide

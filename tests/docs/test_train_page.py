"""The tutorial "Run EDGE or Lodge": its commands run, and the trainers' commands are those of the exports."""

import json
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from dancedata.cli.app import app
from dancedata.datasets.finedance import FineDance
from dancedata.synthetic import write_synthetic
from tests.docs.pages import blocks_of, text_of

EDGE, LODGE = text_of("docs/tutorials/run-edge-or-lodge.md").split("## Lodge on FineDance")


def _of_trainer(text: str, folder: str) -> list[str]:
    """Return the lines of the page that call a trainer on an export."""
    lines = [line for block in blocks_of(text, "") for line in block.splitlines()]
    return [line for line in lines if "train.py" in line and f"{folder}/" in line]


def run(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
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
    run(EDGE, tmp_path, monkeypatch)
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
    assert "Lodge's loader" in "".join(run(LODGE, tmp_path, monkeypatch))  # what it will miss of the 202 tracks
    export = tmp_path / "exports" / "lodge"
    assert {path.name for path in export.iterdir()} >= {"assets.yaml", "Normalizer.pth", "finedance"}
    guide = (export / "README.md").read_text()
    lines = _of_trainer(LODGE, "exports/lodge")
    assert len(lines) == 2
    assert [line for line in lines if line.replace("~", str(tmp_path)) not in guide] == []
    (link,) = (line for line in LODGE.splitlines() if line.startswith("mkdir"))
    assert link in guide

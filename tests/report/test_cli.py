"""dancedata report and dancedata view --video on the command line."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from dancedata.cli.app import app
from dancedata.report import write_report

RUN = CliRunner()


def test_report_writes_a_page_and_says_what_stands_out(demo: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = RUN.invoke(app, ["report", str(demo), "--clips", "1"])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("demo-report.html: 0.")
    assert "note: " in done.stdout
    assert os.listdir(tmp_path) == ["demo-report.html"]
    again = RUN.invoke(app, ["report", str(demo)])
    assert again.exit_code == 2
    assert "--overwrite" in again.stderr


def test_json_has_every_number_and_writes_nothing_by_itself(demo: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = RUN.invoke(app, ["report", str(demo), "--json"])
    assert json.loads(done.stdout) == json.loads(json.dumps(write_report(demo).to_json()))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--clips", "some"], "not a number of clips"),
        (["--audio", "embed"], "--source"),
        (["--audio", "loud"], "unknown audio"),
        (["--max-mb", "0.01"], "--clips none"),
    ],
)
def test_wrong_usage_ends_with_2(demo: Path, tmp_path: Path, arguments: list[str], words: str) -> None:
    done = RUN.invoke(app, ["report", str(demo), "--to", str(tmp_path / "x.html"), *arguments])
    assert (done.exit_code, words in done.stderr) == (2, True), done.output
    assert os.listdir(tmp_path) == []


def test_damaged_data_end_with_1(demo: Path, tmp_path: Path) -> None:
    done = RUN.invoke(app, ["report", str(tmp_path / "nothing"), "--to", str(tmp_path / "x.html")])
    assert done.exit_code == 1
    assert "no finished dataset" in done.stderr


def test_a_video_needs_a_clip_and_a_source(demo: Path, tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    video = ["--video", str(tmp_path / "a.mp4")]
    assert "name it" in RUN.invoke(app, ["view", str(demo), *video]).stderr.lower()
    clip = write_report(demo).document["clips"][0]["clip"]
    assert "--source DIR" in RUN.invoke(app, ["view", str(demo), clip, *video, "--audio", "embed"]).stderr
    assert os.listdir(tmp_path) == []

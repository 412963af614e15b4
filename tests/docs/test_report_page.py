"""docs/report.md: its blocks run and print what they show, and it names every option of the command."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from dancedata.cli.app import app
from dancedata.pipeline.build import build
from dancedata.recipes.parse import load_recipe

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "report.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with data/demo in it."""
    folder = tmp_path_factory.mktemp("demo")
    build(load_recipe("demo"), folder / "data" / "demo-source", folder / "data" / "demo", cache=folder / "cache")
    return folder


def test_the_page_prints_what_it_says(
    demo: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(demo)
    blocks = re.findall(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", PAGE, flags=re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2
    for code, output in blocks:
        exec(compile(code, "report.md", "exec"), {})
        assert capsys.readouterr().out == output
    assert {"demo.html", "poses.pdf", "features.png"} <= {p.name for p in demo.iterdir()}


def test_the_commands_run(demo: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    commands = re.findall(r"^```sh\n(.*?)^```", PAGE, flags=re.DOTALL | re.MULTILINE)
    for command, file in zip(commands, ("demo-report.html", "dance.mp4"), strict=True):
        words = shlex.split(command)
        assert words[0] == "dancedata"
        done = subprocess.run(
            [sys.executable, "-W", "error", "-m", *words], env=environment, cwd=demo, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith(file)
    assert (demo / "demo-report.html").stat().st_size < 1_500_000


def test_every_option_is_on_the_page() -> None:
    import typer

    command = typer.main.get_command(app).commands["report"]  # type: ignore[attr-defined]
    options = {o for p in command.params for o in p.opts if o.startswith("--")} - {"--help"}
    assert [o for o in options if o not in PAGE] == []

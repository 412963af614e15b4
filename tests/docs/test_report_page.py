"""docs/report.md: its blocks run and print what they show, and it names every option of the command."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.testing import CliRunner

import dancedata
from dancedata.cli.app import app
from tests.docs.pages import blocks, text_of, with_output

CLIP = "gBR_sBM_cAll_d04_mBR4_ch03"
#: Clips of two seconds instead of thirteen; a video takes 20 ms a frame.
SMALL = {
    "dataset.synthetic": {"songs": 3, "clips_per_song": 2, "clip_s": 2}, "windows": {"length_s": 1, "stride_s": 0.5},
}  # fmt: skip


@dataclass(frozen=True)
class Demo:
    """A folder with data/demo in it, and the clip used in place of the page's."""

    folder: Path
    clip: str

    @property
    def whole(self) -> bool:
        """True for the demo of the page."""
        return self.clip == CLIP


@pytest.fixture(scope="module", params=["small", pytest.param("whole", marks=pytest.mark.nightly)])
def demo(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Demo:
    folder = tmp_path_factory.mktemp("demo")
    overrides = SMALL if request.param == "small" else {}
    out = folder / "data" / "demo"
    dancedata.build("demo", out=out, overrides=overrides, jobs=1, progress=False)
    return Demo(folder, CLIP if not overrides else dancedata.open(out).clips()[0].id)


def numbers_hidden(text: str) -> str:
    """Return a text in which every number is one sign."""
    return re.sub(r"\d[\d,]*", "#", text)


def test_the_page_prints_the_output_shown(demo, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(demo.folder)
    shown = with_output("docs/report.md")
    assert len(shown) == 2
    for code, output in shown:
        exec(compile(code.replace(CLIP, demo.clip), "report.md", "exec"), {})
        printed = capsys.readouterr().out
        assert numbers_hidden(printed) == numbers_hidden(output)
        assert not demo.whole or printed == output
    assert {"demo.html", "poses.pdf", "features.png"} <= {p.name for p in demo.folder.iterdir()}


def test_the_commands_run(demo: Demo, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.chdir(demo.folder)
    for command, file in zip(
        blocks("docs/report.md", "sh"), ("demo-report.html", "README.md", "dance.mp4"), strict=True
    ):
        name, *words = shlex.split(command.replace(CLIP, demo.clip))
        assert name == "dancedata"
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
        assert done.stdout.startswith(file)
    assert (demo.folder / "demo-report.html").stat().st_size < 1_500_000


def test_every_option_is_on_the_page() -> None:
    import typer

    command = typer.main.get_command(app).commands["report"]  # type: ignore[attr-defined]
    options = {o for p in command.params for o in p.opts if o.startswith("--")} - {"--help"}
    assert [o for o in options if o not in text_of("docs/report.md")] == []

"""The guide on looking at a dataset: its commands, keys and notebook cell."""

import re
import shlex
import threading
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

import dancedata
from dancedata.cli.app import app
from dancedata.formats.motion_files import motion_file
from dancedata.synthetic import synthesise_motion, write_synthetic
from dancedata.viewer.notebook import html_of
from tests.docs.pages import blocks, text_of

PAGE = text_of("docs/guides/look.md")
CLIP = "gPO_sFM_cAll_d10_mPO4_ch02"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small datasets with the names of the page."""
    here = tmp_path_factory.mktemp("page")
    source = write_synthetic(here / "data" / "demo-source", songs=2, clips_per_song=2, clip_s=2.5)
    for name in ("demo", "other"):
        recipe = {
            "recipe": 1, "name": name, "dataset": {"aist++": {}}, "windows": {"length_s": 2, "stride_s": 1},
            "motion": {"edge151": {}}, "audio": {"librosa35": {}},
        }  # fmt: skip
        dancedata.build(recipe, source, here / "data" / name, jobs=1, cache=here / "cache", progress=False)
    (here / "samples").mkdir()
    clip = dancedata.open(here / "data" / "demo").clips()[0].id
    np.save(here / "samples" / f"{clip}.npy", np.zeros((30, 151), np.float32))
    np.save(here / "samples.npy", np.zeros((2, 30, 151), np.float32))
    for name in ("captures", "songs", "edge", "mine"):
        (here / name).mkdir()
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0]
    (here / "captures" / "solo.bvh").write_bytes(motion_file(motion, "bvh"))
    soundfile.write(here / "songs" / "solo.wav", np.zeros(44_100), 22_050)
    for name in ("edge", "mine"):
        np.save(here / name / f"{clip}.npy", motion.joints())
    return here


def test_its_commands_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process; test_server.py ends a separate process with Ctrl-C."""
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.chdir(folder)
    over = threading.Event()
    over.set()
    monkeypatch.setattr("dancedata.viewer.view._interrupt", lambda: over)
    known = dancedata.open(folder / "data" / "demo").clips()[0].id
    commands = [line for block in blocks("docs/guides/look.md", "sh") for line in block.splitlines()]
    commands = [command for command in commands if not command.startswith("dancedata study")]  # see tests/study
    assert len(commands) == 11
    for command in commands:
        words = shlex.split(command.replace(CLIP, known))
        served = words[1] == "view" and "--out" not in words
        done = CliRunner().invoke(app, [*words[1:], *(["--no-browser"] if served else [])])
        assert done.exit_code == 0, f"{command}\n{done.output}"
        if served:
            assert re.match(r"http://127\.0\.0\.1:\d+/\?token=\S+#(clip|group)=", done.stdout), done.stdout
    for name in ("clip.html", "dance.mp4", "demo-report.html"):
        assert 20_000 < (folder / name).stat().st_size < 1_500_000


def test_its_notebook_cell_shows_the_clip(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    cell = blocks("docs/guides/look.md", "python")[0]
    known = dancedata.open(folder / "data" / "demo").clips()[0].id
    *before, last = cell.replace(CLIP, known).strip().splitlines()
    names: dict[str, object] = {}
    exec("\n".join(before), names)
    assert html_of(eval(last, names)).startswith("<iframe srcdoc=")


def test_its_keys_are_those_of_the_page() -> None:
    script = files("dancedata.scene").joinpath("static", "js", "controls.js").read_text(encoding="utf-8")
    keys = script[script.index("const KEYS = [") : script.index("function onKey")]
    named = {key.lower() for key in re.findall(r"^ *\[\s*'(.)'", keys, flags=re.MULTILINE) if key.strip()}
    table = PAGE[PAGE.index("| key |") : PAGE.index("**Marks**")].lower()
    assert {"l", "m", "o", "c", "u", "f", "+", "-", "/", "?", "[", "]"} <= named
    missing = [key for key in named if not re.search(rf"(^|[| `,]){re.escape(key)}([`, |;]|$)", table)]
    assert missing == []

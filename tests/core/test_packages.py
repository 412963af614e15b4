"""Optional packages: without each of them, one error that names the extra to install, and never a traceback."""

import subprocess
import sys
import tomllib
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import dancedata
from dancedata.audio.beats.feature import Beats
from dancedata.audio.hf import HuggingFace
from dancedata.audio.jukebox import Jukebox
from dancedata.cli.app import app
from dancedata.clusters.dask import Dask
from dancedata.core import packages
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid
from dancedata.core.packages import MODULES, MissingPackageError, install, require
from dancedata.files.regular_file import sha256_file
from dancedata.plot.dancers import axes_or_new
from tests.messages import raises_message

ROOT = Path(__file__).resolve().parents[2]
SIGNAL = AudioSignal(np.zeros(22050, np.float32), 22050)
FPS = FrameGrid.of(30)
SMALL = [f"--set=dataset.synthetic.{key}" for key in ("songs=4", "clips_per_song=2", "clip_s=6")]
TINY = ["demo", "SOURCE", *SMALL, "--quiet"]
#: Commands by the extra that they need.
COMMANDS = {
    "hf": [
        ["features", "SONG", "--field", "hf", "--out", "out"],
        ["build", *TINY, "--out", "out", "--set", 'audio={"hf": {"model": "MODEL"}}'],
    ],
    "jukebox": [
        ["features", "SONG", "--field", "jukebox", "--out", "out"],
        ["build", *TINY, "--out", "out", "--set", 'audio={"jukebox": {"weights": "x"}}'],
    ],
    "beats": [
        ["build", *TINY, "--out", "out", "--set", 'audio={"beats": {"source": "beat_this", "weights": "x"}}'],
    ],
    "video": [["view", "DEMO", "clip", "--out", "a.mp4"]],
    "ray": [["build", *TINY, "--out", "out", "--cluster", "ray://auto"]],
}  # fmt: skip
CALLS: dict[str, Callable[[], object]] = {
    "hf": lambda: HuggingFace(device="cpu").extract(SIGNAL, FPS),
    "jukebox": lambda: Jukebox(device="cpu").extract(SIGNAL, FPS),
    "beats": lambda: Beats(source="beat_this", weights=Path("x")).resolved(sha256_file),
    "dask": lambda: Dask().connect("tcp://127.0.0.1:1", None).__enter__(),
    "report": lambda: axes_or_new(None, 1, 1),
    "video": lambda: dancedata.plot.write_video("DEMO", "clip", "a.mp4"),
}


class Without(MetaPathFinder):
    """Finds that a package is not installed."""

    def __init__(self, package: str) -> None:
        self.package = package

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name.partition(".")[0] == self.package:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a place for the demo's files, which the first command makes, next to a model."""
    pytest.importorskip("transformers")
    from dancedata.testing.encoders import write_random_model

    folder = tmp_path_factory.mktemp("packages")
    write_random_model("mert", folder / "model")
    return folder / "source"


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], None]:
    """Take a package away; the current folder contains only a song."""
    import soundfile

    monkeypatch.chdir(tmp_path)
    soundfile.write("SONG.wav", SIGNAL.samples, SIGNAL.sample_rate)
    Path("SONG.wav").rename("SONG")
    monkeypatch.setenv("PATH", str(tmp_path))  # no ffmpeg

    def take(name: str) -> None:
        # Not None in sys.modules: scipy looks there for torch, and takes what it finds.
        monkeypatch.delitem(sys.modules, name, raising=False)
        monkeypatch.setattr(sys, "meta_path", [Without(name), *sys.meta_path])

    return take


@pytest.mark.parametrize(("extra", "missing"), [(e, m) for e in COMMANDS for m in MODULES[e]])
def test_commands_name_what_is_missing(without, source, extra, missing):
    without(missing)
    for arguments in COMMANDS[extra]:
        words = [
            word.replace("SOURCE", str(source)).replace("MODEL", str(source.parent / "model")) for word in arguments
        ]
        done = CliRunner().invoke(app, words)
        assert isinstance(done.exception, SystemExit), (arguments, done.exception)
        assert done.exit_code == 2, (arguments, done.output)
        assert f" needs {missing}, which is not installed. {install(extra)}" in done.stderr, arguments
        assert not Path("out").exists()


@pytest.mark.parametrize(("extra", "missing"), [(e, m) for e in CALLS for m in MODULES[e]])
def test_calls_name_what_is_missing(without: Callable[[str], None], extra: str, missing: str) -> None:
    for module in MODULES[extra]:
        pytest.importorskip(module)  # else it is named as well
    without(missing)
    with pytest.raises(MissingPackageError, match=f"needs .*{missing}, which is not installed") as caught:
        CALLS[extra]()
    assert install(extra) in str(caught.value)


def test_several_are_named_at_once(without: Callable[[str], None]) -> None:
    without("torch")
    without("safetensors")
    with raises_message(MissingPackageError, "installed"):
        require("beats")


WITHOUT_ALL = """
import sys
from tests.core.test_packages import Without
sys.meta_path[:0] = [Without(name) for name in sys.argv[2].split(",")]
from typer.testing import CliRunner
from dancedata.cli.app import app
for line in sys.argv[3:]:
    done = CliRunner().invoke(app, [sys.argv[1] if word == "DEMO" else word for word in line.split()])
    assert done.exit_code == 0, (line, done.output, done.exception)
"""


@pytest.mark.nightly
def test_other_commands_need_none_of_them(tmp_path: Path) -> None:
    modules = {*sum(MODULES.values(), ()), "lightning", "pytorch_lightning", "tokenizers"} - {"joblib"}  # librosa's
    commands = [
        " ".join(["build", *TINY, "--out DEMO --jobs 1"]),
        "info DEMO --clips", "check DEMO -q", "info plugins", "evaluate DEMO -q",
        "view DEMO --out page.html", "report DEMO --out report.html --clips 1",
        "export DEMO --to npz --out npz -q", "export DEMO --to bvh --out bvh -q",
        "init mine --plugin-kind metric --out new",
    ]  # fmt: skip
    subprocess.run(
        [sys.executable, "-c", WITHOUT_ALL, "demo", ",".join(sorted(modules)), *commands],
        check=True, cwd=tmp_path, timeout=300,
    )  # fmt: skip


def test_extras_are_those_of_the_distribution() -> None:
    """Modules of the table, and the command that is printed, against pyproject.toml."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert set(MODULES) == set(declared) - {"docs", "dev", "all"}
    names = {"imageio_ffmpeg": "imageio-ffmpeg", "distributed": "dask[distributed]"}
    names["ray"] = "ray[client]"
    brought = {"huggingface_hub": "transformers", "dask": "dask[distributed]"}  # by another one's needs
    for extra, modules in MODULES.items():
        stated = {text.split(">")[0].split("<")[0] for text in declared[extra]}
        own = [module for module in modules if module in stated]
        assert stated == {*own, *(brought.get(m, names.get(m, m)) for m in modules if m not in own)}
    required = [f'{text}; extra == "{extra}"' for extra in MODULES for text in declared[extra]] + ["numpy>=2.0"]
    assert install("torch", required) == 'pip install "torch>=2.5"'
    assert install("video", required) == 'pip install "imageio-ffmpeg>=0.6" "matplotlib>=3.9"'


def test_without_metadata_the_checkout_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "requirements", tuple)
    assert install("hf") == 'pip install ".[hf]" in a checkout of dancedata'


def test_no_text_names_dancedata_on_an_index() -> None:
    texts = [*(ROOT / "dancedata").rglob("*.py"), *(ROOT / "docs").glob("*.md"), ROOT / "README.md"]
    wrong = [path.name for path in texts if "dancedata[" in path.read_text("utf-8")]
    assert wrong == []

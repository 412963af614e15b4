"""Starting is light: what is imported, not how long it takes."""

import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from dancedata.building.compute import cached_results
from dancedata.building.signals import SignalId, identify_audio
from dancedata.cli import command
from dancedata.cli.app import app
from dancedata.execution.cache import Cache
from dancedata.recipes.parse import load_recipe
from tests.takes import makers_of, take_of, unit_of

#: Each of these takes a good part of a second, or needs an extra.
HEAVY = {"torch", "librosa", "scipy", "numba", "sklearn", "pandas", "matplotlib", "soundfile", "soxr"}
#: And these a command needs only once it runs.
LATER = HEAVY | {"h5py", "joblib", "yaml", "rich", "numpy"}


def imported(*args: str) -> set[str]:
    """Top-level packages that a fresh interpreter imports."""
    return {name.split(".")[0] for name in modules(*args)}


def modules(*args: str) -> set[str]:
    """Modules that a fresh interpreter imports."""
    result = subprocess.run([sys.executable, "-X", "importtime", *args], check=True, capture_output=True, text=True)
    lines = [line for line in result.stderr.splitlines() if line.startswith("import time:")]
    names = {line.rsplit("|", 1)[1].strip() for line in lines}
    assert "dancedata" in names
    return names


def test_importing_the_package_is_light():
    assert imported("-c", "import dancedata") & (LATER | {"pydantic", "typer"}) == set()


@pytest.mark.parametrize("args", [["--help"], ["build", "--help"], ["cache", "-h"], ["--version"]])
def test_help_is_light(args: list[str]):
    # pydantic would be loaded by typer, for a flag that is None where it is not given.
    assert imported("-m", "dancedata", *args) & (LATER | {"pydantic"}) <= {"rich"}


def test_reading_is_light():
    names = imported("-c", "import dancedata; dancedata.open")
    assert names & (HEAVY | {"joblib", "pydantic", "typer"}) == set()


def test_listing_is_light():
    """It shows the fields of plug-ins' classes: these need numpy, and nothing that reads, computes or writes."""
    code = "from dancedata.cli.plugins import *; assert 'edge151' in str([*describe_catalogue(catalogue('plugins'))])"
    names = modules("-c", code)
    assert {name.split(".")[0] for name in names} & (HEAVY | {"h5py", "joblib", "pydantic", "typer", "rich"}) == set()
    rooms = {name.split(".")[1] for name in names if name.startswith("dancedata.")}
    assert rooms & {"store", "torch", "testing"} == set()
    assert "dancedata.building.build" not in names
    names = modules("-m", "dancedata", "info", "plugins")
    # typer itself loads pydantic for an argument.
    assert {name.split(".")[0] for name in names} & (HEAVY | {"h5py", "joblib", "rich"}) == set()
    rest = {name for name in names if name.startswith("dancedata.audio.hf.families")}
    assert names & rest == set()


def test_a_recipe_loads_its_own_plug_ins():
    code = "import sys; from dancedata.recipes.parse import load_recipe; load_recipe('aist++'); print(*sys.modules)"
    names = set(
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    )
    assert {"dancedata.datasets.aistpp", "dancedata.audio.librosa35.feature"} <= names
    others = ("datasets.finedance", "datasets.folder", "audio.jukebox", "representations.fact219", "synthetic")
    assert [name for name in names if name.startswith(tuple(f"dancedata.{other}" for other in others))] == []


def test_every_command_chooses_how_results_are_computed():
    """Before it begins: see `command.command`."""
    for one in app.registered_commands:
        assert one.callback.__code__.co_filename == command.__file__, one.name  # type: ignore[union-attr]


RUN = """
import pickle, sys
cache, units = pickle.load(open(sys.argv[1], "rb"))
from dancedata.building.compute import make
for unit in units:
    make(cache, unit)
"""


def test_a_worker_that_encodes_motion_loads_no_feature(corpus: Path, tmp_path: Path):
    recipe, cache = load_recipe("aist++"), Cache(tmp_path / "cache")
    (ref, *_) = recipe.dataset.scan(corpus).clips
    unit = unit_of(makers_of(recipe)["edge151"], take_of(recipe, [(ref, cache.file_sha256(ref.motion_path))]))
    (tmp_path / "unit").write_bytes(pickle.dumps((cache, [unit])))
    names = modules("-c", RUN, str(tmp_path / "unit"))
    assert "dancedata.representations.edge151" in names
    heavy = HEAVY | {"pydantic", "h5py", "typer", "joblib", "importlib.metadata"}
    assert names & heavy == set()
    # What knows a song needs numpy alone.
    features = ("librosa35", "bailando", "stft", "beats", "jukebox", "hf", "networks", "file", "signal", "stretch")
    places = tuple(f"dancedata.audio.{feature}" for feature in features)
    assert [name for name in names if name.startswith(places)] == []
    assert cached_results(cache, unit) is not None


def test_workers_import_neither_pydantic_nor_librosa(corpus: Path, tmp_path: Path):
    recipe, cache = load_recipe("aist++"), Cache(tmp_path / "cache")
    (ref, *_) = recipe.dataset.scan(corpus).clips
    signal = identify_audio(cache, ref.audio_path)
    assert isinstance(signal, SignalId)
    take = take_of(recipe, [(ref, cache.file_sha256(ref.motion_path))], signal=signal)
    units = [unit_of(makers_of(recipe)[name], take) for name in ("edge151", "librosa35")]
    (tmp_path / "units").write_bytes(pickle.dumps((cache, units)))
    names = imported("-c", RUN, str(tmp_path / "units"))
    assert "soxr" in names
    assert names & {"pydantic", "librosa", "numba", "h5py", "typer", "torch"} == set()
    assert [cached_results(cache, unit) is None for unit in units] == [False, False]


def test_no_worker_is_waited_for_when_a_command_has_ended(corpus: Path, tmp_path: Path):
    """They would end by themselves, but unload all that they have loaded first."""
    code = """if 1:
        import sys
        from pathlib import Path
        from dancedata.__main__ import main
        try:
            main()
        except SystemExit as end:
            assert not end.code, end
        assert "joblib" in sys.modules
        children = Path(f"/proc/self/task/{Path('/proc/self').resolve().name}/children").read_text().split()
        commands = [Path(f"/proc/{child}/cmdline").read_bytes() for child in children]
        assert not [command for command in commands if b"popen_loky" in command], commands
    """
    command = ["build", "aist++", "--set", "audio={}", "--jobs", "2", str(corpus), "--quiet"]
    # A separate cache: from a full one no worker is started.
    command += ["--out", str(tmp_path / "out"), "--cache", str(tmp_path / "cache")]
    subprocess.run([sys.executable, "-c", code, *command], check=True)


@pytest.mark.parametrize("closed", [(2,), (0, 1, 2)])
def test_a_command_runs_without_standard_streams(corpus: Path, cache: Path, tmp_path: Path, closed: tuple[int, ...]):
    """As under some schedulers. A file of the dataset must not get a stream's number."""
    command = [sys.executable, "-m", "dancedata", "build", "aist++", "--set", "audio={}", "--jobs", "1"]
    command += [str(corpus), "--out", str(tmp_path / "out"), "--cache", str(cache)]
    redirections = " ".join(f"{number}>&-" for number in closed)
    done = subprocess.run(["sh", "-c", f'exec "$@" {redirections}', "sh", *command], check=False, capture_output=True)
    assert done.returncode == 0
    assert (tmp_path / "out" / "dataset.json").exists()

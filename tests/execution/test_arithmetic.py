"""The same bytes for all kernels that a machine would choose, all user settings and all processes."""

import hashlib
import multiprocessing
import os
import platform
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from dancedata.cache import FeatureCache
from dancedata.core import system
from dancedata.core.errors import DanceDataError, DataError
from dancedata.execution import arithmetic, units
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units
from dancedata.synthetic import synthesise_song

RECIPE = """recipe: 1
name: kernels
dataset: {synthetic: {songs: 2, clips_per_song: 2, clip_s: 6}}
fps: 30
transforms: TRANSFORMS
windows: {length_s: 5, stride_s: 0.5}
motion: {edge151: {}, joints: {}}
audio: {librosa35: {}}
keymotion: {lodge: {}}
augment: {mirror: true}
"""
#: Settings that a user may have, or another processor would choose.
SETTINGS = {
    "nothing": {},
    "Sandybridge": {"OPENBLAS_CORETYPE": "Sandybridge"},
    "no AVX-512 in numpy": {"NPY_DISABLE_CPU_FEATURES": "X86_V4"},
    "no AVX2 in numpy": {"NPY_DISABLE_CPU_FEATURES": "X86_V3"},
    "older processor": {
        "OPENBLAS_CORETYPE": "Sandybridge", "NPY_DISABLE_CPU_FEATURES": "X86_V3", "OPENBLAS_L2_SIZE": "1024",
    },
    **{kernel: {"OPENBLAS_CORETYPE": kernel} for kernel in ("Haswell", "Zen", "Nehalem", "SkylakeX", "Prescott")},
    "no AVX2 in the C library": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2_Usable,-AVX2,-FMA"},
    "blocks": {"OPENBLAS_BLOCK_FACTOR": "2"},
}  # fmt: skip
QUICK = ("nothing", "older processor")
needs_reference = pytest.mark.skipif(
    not arithmetic.has_reference(), reason="this processor has no AVX2: nothing is promised beyond this machine"
)


def run(*command: object, **settings: str) -> str:
    """Run Python without what the tests' own process has chosen, but with `settings`."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("OPENBLAS_", "NPY_"))} | settings
    done = subprocess.run(
        [sys.executable, *map(str, command)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


PRODUCT = """
import numpy as np

a, b = (np.random.default_rng(seed).standard_normal((540, 660)) for seed in (0, 1))
assert np.abs(a @ b.T - np.einsum("ik,jk->ij", a, b)).max() < 1e-11  # sums of 660 terms of about 1 in another order
"""


@needs_reference
@pytest.mark.parametrize("size", [None, "1024"])  # KiB: of this processor; Zen 4's and Skylake's
def test_long_products_do_not_depend_on_the_cache_of_the_processor(size: str | None) -> None:
    # With OpenBLAS 0.3.34 (numpy 2.5) and the size of 1 MiB, Haswell's kernels overrun the stack.
    user = {} if size is None else {"OPENBLAS_L2_SIZE": size}
    run("-c", PRODUCT, **user | arithmetic.variables())


@pytest.fixture
def fresh() -> Iterator[None]:
    """Forget what this process computes with, before a test and after it."""
    arithmetic._description.cache_clear()
    yield
    arithmetic._description.cache_clear()


STARTED = [f"{name}={value}" for name, value in arithmetic.variables().items()]


@needs_reference
@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize(
    ("started", "pool", "is_reference"),
    [
        (STARTED, {}, True),
        ([], {}, False),
        ([*STARTED, "GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2"], {}, False),
        ([line.replace("256", "1024") for line in STARTED], {}, False),
        (STARTED, {"architecture": "SkylakeX"}, False),
        (STARTED, {"internal_api": "mkl"}, False),
    ],
)
def test_only_a_process_that_was_started_so_computes_with_the_reference(monkeypatch, started, pool, is_reference):
    monkeypatch.setattr(arithmetic, "started_with", lambda: started)
    monkeypatch.setattr(arithmetic, "_is_adopted", False)
    pools = [{"internal_api": "openblas", "architecture": "Haswell", "version": "0.3.34", **pool}]
    monkeypatch.setattr(arithmetic, "_blas_pools", lambda: pools)
    assert (arithmetic.here() == arithmetic.REFERENCE) == is_reference
    if not is_reference:  # which kernels another BLAS chooses cannot be read
        assert system.processor() in arithmetic.here()


def hashes(out: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(out.iterdir())}


@pytest.fixture(scope="module", params=["[]", "[slices]"])
def recipe(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recipe") / "kernels.yaml"
    path.write_text(RECIPE.replace("TRANSFORMS", request.param), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def expected(recipe: Path) -> dict[str, str]:
    """A build by the command line, on a machine where nothing is set."""
    return build_by_command(recipe, recipe.parent / "first")


def build_by_command(recipe: Path, folder: Path, **settings: str) -> dict[str, str]:
    """Make a new source, dataset and cache."""
    command = ["-m", "dancedata", "build", recipe, folder / "source", "--out", folder / "out"]
    run(*command, "--cache", folder / "cache", "--jobs", 1, "--quiet", **settings)
    return hashes(folder / "out")


@needs_reference
@pytest.mark.parametrize("recipe", ["[]", pytest.param("[slices]", marks=pytest.mark.nightly)], indirect=True)
@pytest.mark.parametrize(
    "name", ["older processor", *(pytest.param(n, marks=pytest.mark.nightly) for n in SETTINGS if n not in QUICK)]
)
def test_the_command_line_gives_the_same_bytes(recipe, expected, tmp_path, name):
    assert build_by_command(recipe, tmp_path, **SETTINGS[name]) == expected


EXTRACT = """
import sys
import numpy as np
import dancedata
from dancedata.cache import FeatureCache
song, cache, out = sys.argv[1:]
track = dancedata.features(song, "librosa35", fps=30, bpm=100)
windows = FeatureCache(cache)(song, "librosa35", windows=(150, 15), bpm=100)
np.savez(out, track=track, windows=windows)
"""


@needs_reference
def test_features_from_python_are_those_of_the_command_line(tmp_path: Path) -> None:
    """Which this process computes as."""
    song, out = write_song(tmp_path / "song.wav"), tmp_path / "found.npz"
    run("-c", EXTRACT, song, tmp_path / "cache", out, **SETTINGS["older processor"])
    features = FeatureCache(tmp_path / "own")
    with np.load(out) as found:
        np.testing.assert_array_equal(found["track"], features(song, "librosa35", fps=30, bpm=100))
        np.testing.assert_array_equal(found["windows"], features(song, "librosa35", windows=(150, 15), bpm=100))


def write_song(path: Path) -> Path:
    made = synthesise_song("mPO1", length_s=6.0)
    soundfile.write(path, made.pcm, made.signal.sample_rate)
    return path


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process that had loaded numpy before anything could be chosen."""
    here, pid = arithmetic.here, os.getpid()
    monkeypatch.setattr(arithmetic, "here", lambda: "other" if os.getpid() == pid else here())
    monkeypatch.setattr(arithmetic, "_is_adopted", False)
    monkeypatch.setattr(arithmetic, "started_with", list)


def die(path: Path) -> None:
    os._exit(3)


def fail() -> None:
    raise DataError("too faint", reason="nan", where="song.wav")


@needs_reference
@pytest.mark.usefixtures("notebook")
def test_a_worker_computes_with_the_reference_and_survives_what_units_do() -> None:
    """Also with one job, and one after the other."""
    quiet = Progress(quiet=True)
    assert arithmetic.expected() == arithmetic.REFERENCE
    for exact, other in ((True, False), (False, True)):
        (pid,) = run_units(os.getpid, [()], jobs=1, label="x", progress=quiet, exact=exact)
        assert (pid == os.getpid()) is other
    assert units.in_reference(lambda: arithmetic.here()) == arithmetic.REFERENCE  # travels with the call
    with pytest.raises(DataError) as caught:
        units.in_reference(fail)
    assert (caught.value.reason, caught.value.where) == ("nan", "song.wav")
    with pytest.raises(TypeError, match="pickle"):
        units.in_reference(print, threading.Lock())
    with pytest.raises(DanceDataError, match="kills its worker") as died:
        run_units(die, [(Path("song.wav"),)], jobs=1, label="features", progress=quiet)
    assert str(died.value.where) == "song.wav"
    assert units.in_reference(abs, -2) == 2


@needs_reference
@pytest.mark.usefixtures("notebook")
@pytest.mark.parametrize("daemon", [True, False])
def test_a_fork_computes_by_a_worker_of_its_own_or_under_its_own_key(daemon: bool) -> None:
    """Forked workers of a DataLoader are daemons, to which multiprocessing gives no children."""
    mine = units.in_reference(os.getpid)
    context = multiprocessing.get_context("fork")
    queue: Any = context.Queue()
    child = context.Process(target=_ask, args=(queue,), daemon=daemon)
    child.start()
    pid, expected = queue.get(timeout=60)
    child.join(60)
    if daemon:
        assert (pid, expected) == (child.pid, "in the fork")
    else:
        assert pid not in (mine, os.getpid(), child.pid)
        assert expected == arithmetic.REFERENCE
    assert units.in_reference(os.getpid) == mine


def _ask(queue: Any) -> None:
    arithmetic.here = lambda: "in the fork"
    queue.put((units.in_reference(os.getpid), arithmetic.expected()))


@needs_reference
@pytest.mark.usefixtures("notebook")
def test_a_worker_of_a_loader_takes_what_builds_have_computed(tmp_path, monkeypatch):
    """What is missing it computes under a key of its own."""
    song = write_song(tmp_path / "song.wav")
    features = FeatureCache(tmp_path / "cache")
    built = features(song, "librosa35", bpm=100), features(song, "librosa35", windows=(150, 15), bpm=100)
    entries = len(list((tmp_path / "cache" / "features").rglob("*.npy")))
    monkeypatch.setattr(multiprocessing.current_process(), "_config", {"daemon": True})
    assert arithmetic.expected() == "other"
    taken = features(song, "librosa35", bpm=100), features(song, "librosa35", windows=(150, 15), bpm=100)
    for one, other in zip(built, taken, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(list((tmp_path / "cache" / "features").rglob("*.npy"))) == entries
    shutil.rmtree(tmp_path / "cache" / "features")
    features(song, "librosa35", bpm=100)
    own = {path.name for path in (tmp_path / "cache" / "features").rglob("*.npy")}
    monkeypatch.undo()
    features(song, "librosa35", bpm=100)
    assert own < {path.name for path in (tmp_path / "cache" / "features").rglob("*.npy")}


#: Modules of Python's own that processes import when they start.
IN_THE_WAY = ("json", "random", "queue", "struct", "signal", "multiprocessing", "numpy", "joblib")


def test_modules_of_the_working_folder_do_not_replace_others(tmp_path: Path) -> None:
    """No file of a data folder runs because it is the working folder."""
    for name in IN_THE_WAY:
        (tmp_path / f"{name}.py").write_text("open('ran', 'w').close()\nraise SystemExit('foreign code')\n")
    script = tmp_path / "elsewhere" / "script.py"
    script.parent.mkdir()
    script.write_text(
        "import os, sys\n"
        "from dancedata.execution.progress import Progress\n"
        "from dancedata.execution.units import in_reference, run_units\n"
        "sys.path.append(3)\n"  # Python ignores what is no text
        "assert in_reference(abs, -2) == 2\n"
        "calls = [(n,) for n in (-2, -3)]\n"
        "assert run_units(abs, calls, jobs=2, label='units', progress=Progress(quiet=True)) == [2, 3]\n"
    )
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "ran").exists()


@pytest.mark.usefixtures("fresh")
def test_machines_without_the_level_keep_results_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever they compute with is in the keys, and nothing is chosen for them."""
    monkeypatch.setattr(arithmetic, "has_reference", lambda: False)
    monkeypatch.setattr(arithmetic, "started_with", lambda: ["OPENBLAS_CORETYPE=Nehalem"])
    own = arithmetic.here()
    assert own.startswith(f"{platform.machine()}, openblas ")
    assert own.endswith("OPENBLAS_CORETYPE=Nehalem")
    assert arithmetic.expected() == own
    assert "OPENBLAS_CORETYPE" not in arithmetic.variables()
    assert units.in_reference(os.getpid) == os.getpid()


@needs_reference
@pytest.mark.parametrize(
    ("version", "features"),
    [("2.0.2", "SSSE3 SSE41 POPCNT SSE42 AVX F16C FMA3 AVX2"), ("2.4.6", "X86_V3"), ("3.0.0rc1", "X86_V3")],
)
def test_versions_of_numpy_name_features_in_their_own_way(monkeypatch, version, features):
    monkeypatch.setattr(arithmetic, "package_version", lambda name: version)
    assert arithmetic.variables()["NPY_ENABLE_CPU_FEATURES"] == features


@needs_reference
def test_only_the_choice_of_instructions_is_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLIBC_TUNABLES", "glibc.malloc.check=1:glibc.cpu.hwcaps=-AVX2")
    assert arithmetic.variables()["GLIBC_TUNABLES"] == "glibc.malloc.check=1"

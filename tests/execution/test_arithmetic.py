"""The same bytes for all kernels that a machine would choose, all user settings and all processes."""

import hashlib
import multiprocessing
import os
import platform
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from dancedata.core import system
from dancedata.core.errors import DataError
from dancedata.execution import arithmetic, reference_process
from dancedata.execution.progress import Progress
from dancedata.execution.reference_process import ReferenceProcess, ReferenceProcessError
from dancedata.execution.units import run_units
from dancedata.synthetic import synthesise_song
from tests.messages import raises_message

RECIPE = """recipe: 1
name: kernels
dataset: {synthetic: {songs: 2, clips_per_song: 2, clip_s: 6}}
fps: 30
scope: SCOPE
windows: {length_s: 5, stride_s: 0.5}
motion: {edge151: {}, joints: {}}
audio: {librosa35: {}}
keymotion: {lodge: {}}
augment: {mirror: true}
"""
BUILD = """
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from dancedata.pipeline.build import build
from dancedata.recipes.parse import load_recipe

recipe, source, out, cache, jobs = sys.argv[1:]
import numpy  # before anything can be chosen
build(load_recipe(recipe), Path(source), Path(out), cache=Path(cache), jobs=int(jobs))
"""
#: Settings that a user may have, or another processor would choose.
SETTINGS = {
    "nothing": {},
    "Sandybridge": {"OPENBLAS_CORETYPE": "Sandybridge"},
    "no AVX-512 in numpy": {"NPY_DISABLE_CPU_FEATURES": "X86_V4"},
    "no AVX2 in numpy": {"NPY_DISABLE_CPU_FEATURES": "X86_V3"},
    "older processor": {
        "OPENBLAS_CORETYPE": "Sandybridge",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3",
        "OPENBLAS_L2_SIZE": "1024",
    },
}
MORE_SETTINGS = {
    **{kernel: {"OPENBLAS_CORETYPE": kernel} for kernel in ("Haswell", "Zen", "Nehalem", "SkylakeX", "Prescott")},
    "no AVX2 in the C library": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2_Usable,-AVX2,-FMA"},
    "blocks": {"OPENBLAS_BLOCK_FACTOR": "2"},
}
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
@pytest.mark.skipif(platform.machine() != "x86_64", reason="Haswell's kernels")
@pytest.mark.parametrize("size", [None, "1024"])  # KiB: of this processor; Zen 4's and Skylake's
def test_long_products_do_not_depend_on_the_cache_of_the_processor(
    monkeypatch: pytest.MonkeyPatch, size: str | None
) -> None:
    # With OpenBLAS 0.3.34 (numpy 2.5) and the size of 1 MiB, Haswell's kernels overrun the stack.
    monkeypatch.delenv("OPENBLAS_L2_SIZE", raising=False)
    if size is not None:
        monkeypatch.setenv("OPENBLAS_L2_SIZE", size)
    chosen = arithmetic.environment()
    assert chosen["OPENBLAS_L2_SIZE"] == "256"
    run("-c", PRODUCT, **{name: value for name, value in chosen.items() if name.startswith(("OPENBLAS_", "NPY_"))})


@pytest.mark.skipif(platform.machine() != "x86_64", reason="Haswell's kernels")
@pytest.mark.parametrize(
    ("version", "started", "is_reference"),
    [
        ("0.3.31.188.0", [], True),
        ("0.3.34.237.2", [], False),
        (None, [], False),
        ("0.3.34.237.2", ["OPENBLAS_L2_SIZE=256"], True),
        ("0.3.34.237.2", ["OPENBLAS_L2_SIZE=1024"], False),
    ],
)
def test_blocks_by_the_processor_are_not_the_reference(
    monkeypatch: pytest.MonkeyPatch, version: str | None, started: list[str], is_reference: bool
) -> None:
    monkeypatch.setattr(arithmetic, "has_reference", lambda: True)
    monkeypatch.setattr(arithmetic, "started_with", lambda: started)
    monkeypatch.setattr(arithmetic, "_is_adopted", False)
    monkeypatch.setattr(arithmetic, "_numpy_code", lambda: [("X86_V3", ["X86_V3"])])
    pool = {"internal_api": "openblas", "architecture": "Haswell", "version": version}
    monkeypatch.setattr(arithmetic, "_blas_pools", lambda: [pool])
    arithmetic._description.cache_clear()
    try:
        assert (arithmetic.here() == arithmetic.REFERENCE) == is_reference
    finally:
        arithmetic._description.cache_clear()


def hashes(out: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(out.iterdir())}


@pytest.fixture(scope="module", params=["track", "window"])
def recipe(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recipe") / "kernels.yaml"
    path.write_text(RECIPE.replace("SCOPE", request.param), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def expected(recipe: Path) -> dict[str, str]:
    """A build by the command line, on a machine where nothing is set."""
    return build_by_command(recipe, recipe.parent / "first")


def build_by_command(recipe: Path, folder: Path, **settings: str) -> dict[str, str]:
    """Make a new source, dataset and cache."""
    command = ["-m", "dancedata", "build", recipe, "--source", folder / "source", "--out", folder / "out"]
    run(*command, "--cache", folder / "cache", "--jobs", 1, "--quiet", **settings)
    return hashes(folder / "out")


@needs_reference
@pytest.mark.parametrize("recipe", ["track", pytest.param("window", marks=pytest.mark.nightly)], indirect=True)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name == "older processor" else pytest.mark.nightly)
        for name in SETTINGS
        if name != "nothing"
    ],
)
def test_the_command_line_gives_the_same_bytes(
    recipe: Path, expected: dict[str, str], tmp_path: Path, name: str
) -> None:
    assert build_by_command(recipe, tmp_path, **SETTINGS[name]) == expected


@needs_reference
@pytest.mark.nightly
@pytest.mark.parametrize("name", MORE_SETTINGS)
def test_the_command_line_gives_the_same_bytes_under_any_settings(
    recipe: Path, expected: dict[str, str], tmp_path: Path, name: str
) -> None:
    assert build_by_command(recipe, tmp_path, **MORE_SETTINGS[name]) == expected


@needs_reference
@pytest.mark.parametrize("recipe", ["track", pytest.param("window", marks=pytest.mark.nightly)], indirect=True)
@pytest.mark.parametrize(
    ("jobs", "name"), [pytest.param(1, "nothing", marks=pytest.mark.nightly), (2, "older processor")]
)
def test_a_build_from_python_gives_the_same_bytes(
    recipe: Path, expected: dict[str, str], tmp_path: Path, jobs: int, name: str
) -> None:
    """There numpy was loaded before; the source is made by it, too."""
    source, out, cache = (tmp_path / part for part in ("source", "out", "cache"))
    run("-c", BUILD, recipe, source, out, cache, jobs, **SETTINGS[name])
    assert hashes(out) == expected


EXTRACT = """
import sys
import numpy as np
import dancedata
from dancedata.cache import FeatureCache
song, cache, out = sys.argv[1:]
track = dancedata.extract("librosa35", song, fps=30, start_bpm=100)
kept = FeatureCache(cache).get("librosa35", song, fps=30, start_bpm=100)
windows = FeatureCache(cache).get_windows("librosa35", song, start_bpm=100)
assert np.array_equal(track, kept)
np.savez(out, track=track, windows=windows)
"""


@needs_reference
def test_features_from_python_are_those_of_the_command_line(tmp_path: Path) -> None:
    song = tmp_path / "song.wav"
    made = synthesise_song("mPO1", length_s=6.0)
    soundfile.write(song, made.pcm, made.signal.sample_rate)
    found = []
    for name in ("nothing", "older processor"):
        run("-c", EXTRACT, song, tmp_path / name, tmp_path / f"{name}.npz", **SETTINGS[name])
        found.append(dict(np.load(tmp_path / f"{name}.npz")))
    run("-m", "dancedata", "features", song, "--out", tmp_path, "--bpm", 100)
    command = np.load(tmp_path / "song.librosa35.npy")
    for one in found:
        assert np.array_equal(one["track"], command)
        assert np.array_equal(one["windows"], found[0]["windows"])


@pytest.fixture
def process() -> Iterator[ReferenceProcess]:
    started = ReferenceProcess()
    yield started
    started.end()


@needs_reference
def test_the_reference_process_uses_the_promised_instructions(process: ReferenceProcess) -> None:
    assert process.arithmetic == arithmetic.REFERENCE
    assert process.call(arithmetic.here, ()) == arithmetic.REFERENCE
    assert arithmetic.environment()["OPENBLAS_CORETYPE"] == "Haswell"


def test_exceptions_are_raised_and_the_process_continues(process: ReferenceProcess) -> None:
    def fail() -> None:
        raise DataError("too faint", reason="nan", where="song.wav")

    with raises_message(DataError, "faint", where="song.wav") as caught:
        process.call(fail, ())
    assert caught.value.reason == "nan"
    # Neither function nor class can be imported there: they travel with the call.
    assert process.call(lambda x: x + 1, (3,)) == 4


def test_unpicklable_values_are_a_clear_error(process: ReferenceProcess) -> None:
    with pytest.raises(TypeError, match="cannot pickle"):
        process.call(lambda: threading.Lock(), ())
    assert process.call(abs, (-2,)) == 2


def test_a_dead_process_is_an_error_and_the_next_call_starts_another(process: ReferenceProcess) -> None:
    with raises_message(ReferenceProcessError, "process"):
        process.call(os.kill, (process.call(os.getpid, ()), signal.SIGKILL))
    with raises_message(ReferenceProcessError, "process"):
        process.call(os._exit, (3,))
    assert process.call(abs, (-2,)) == 2


def test_an_interrupted_call_does_not_answer_the_next_one(
    process: ReferenceProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    receive = process._receive

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(process, "_receive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        process.call(abs, (-1,))
    monkeypatch.setattr(process, "_receive", receive)
    assert process.call(abs, (-2,)) == 2


def test_a_unit_that_kills_the_process_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a notebook, where nothing else could tell."""
    monkeypatch.setattr(arithmetic, "here", lambda: "something else")
    with raises_message(ReferenceProcessError, "process", where="song.wav") as caught:
        run_units(_die, [(Path("song.wav"),)], jobs=1, label="features", progress=Progress(quiet=True))
    assert str(caught.value.where) == "song.wav"


def _die(path: Path) -> None:
    os._exit(3)


@needs_reference
def test_a_fork_starts_a_process_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forked workers of a DataLoader are daemons, to which multiprocessing gives no children."""
    monkeypatch.setattr(arithmetic, "here", lambda: "something else")
    mine = reference_process.compute(os.getpid)
    assert mine == reference_process.compute(os.getpid) != os.getpid()
    context = multiprocessing.get_context("fork")
    queue: Any = context.Queue()
    child = context.Process(target=_ask, args=(queue,), daemon=True)
    child.start()
    assert queue.get(timeout=60) not in (mine, os.getpid(), child.pid)
    child.join()
    assert reference_process.compute(os.getpid) == mine


def _ask(queue: Any) -> None:
    queue.put(reference_process.compute(os.getpid))


def test_it_ends_with_its_owner_though_a_fork_lives_on() -> None:
    """As with persistent workers of a DataLoader, which the interpreter ends only later."""
    context = multiprocessing.get_context("fork")
    started = ReferenceProcess()
    lives = context.Event()
    child = context.Process(target=lives.wait, args=(60,), daemon=True)
    child.start()
    try:
        ending = threading.Thread(target=started.end, daemon=True)
        ending.start()
        ending.join(20)
        assert not ending.is_alive()
    finally:
        lives.set()
        child.join()


def test_module_folders_that_are_not_text_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path, Path("/somewhere")])
    started = ReferenceProcess()
    assert started.call(abs, (-2,)) == 2
    started.end()


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
        "from dancedata.execution.units import run_units\n"
        "from dancedata.execution.reference_process import ReferenceProcess\n"
        "assert ReferenceProcess().call(abs, (-2,)) == 2\n"
        "calls = [(n,) for n in (-2, -3)]\n"
        "assert run_units(abs, calls, jobs=2, label='units', progress=Progress(quiet=True)) == [2, 3]\n"
    )
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "ran").exists()


def test_machines_without_the_level_keep_results_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever they compute with is in the keys, and nothing is chosen for them."""
    monkeypatch.setattr(arithmetic, "has_reference", lambda: False)
    monkeypatch.setattr(arithmetic, "started_with", list)
    arithmetic._description.cache_clear()
    try:
        own = arithmetic.here()
        assert own.startswith(f"{platform.machine()}, openblas ")
        assert reference_process.expected() == own
        assert "OPENBLAS_CORETYPE" not in arithmetic.environment()
        assert reference_process.compute(os.getpid) == os.getpid()
    finally:
        arithmetic._description.cache_clear()


def test_a_blas_that_says_nothing_of_its_kernels_is_bound_to_its_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arithmetic, "_blas", lambda: ["mkl 2025.1"])
    arithmetic._description.cache_clear()
    try:
        assert "mkl 2025.1" in arithmetic.here()
        assert arithmetic.here().endswith(system.processor())
    finally:
        arithmetic._description.cache_clear()


@pytest.mark.parametrize(
    ("version", "features"),
    [("2.0.2", "SSSE3 SSE41 POPCNT SSE42 AVX F16C FMA3 AVX2"), ("2.4.6", "X86_V3"), ("3.0.0rc1", "X86_V3")],
)
def test_versions_of_numpy_name_features_in_their_own_way(
    monkeypatch: pytest.MonkeyPatch, version: str, features: str
) -> None:
    monkeypatch.setattr(arithmetic, "version", lambda name: version)
    assert arithmetic._numpy_features() == features


def test_only_chosen_settings_are_changed_and_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Nehalem")
    tunables = "glibc.malloc.check=1:glibc.cpu.hwcaps=-AVX2"
    monkeypatch.setenv("GLIBC_TUNABLES", tunables)
    with arithmetic.adopted_by_children():
        assert os.environ.get("OPENBLAS_CORETYPE") == ("Haswell" if arithmetic.has_reference() else None)
        assert os.environ["GLIBC_TUNABLES"] == "glibc.malloc.check=1"
        monkeypatch.setenv("SOMEBODY", "else")
    assert (os.environ["OPENBLAS_CORETYPE"], os.environ["SOMEBODY"]) == ("Nehalem", "else")
    assert os.environ["GLIBC_TUNABLES"] == tunables

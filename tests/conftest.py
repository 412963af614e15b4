"""Fixtures that every test may use."""

import copy
import gc
import hashlib
import json
import lzma
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache, wraps
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import typer.testing
from hypothesis import settings

from dancedata.execution import arithmetic
from dancedata.files.locks import open_locked, unlock
from dancedata.files.regular_file import sha256_file
from tests.browser import browser, plain_chromium, webgl_browser, webgl_chromium  # noqa: F401 (fixtures)
from tests.remote.children import PACKAGES

# Tests start hundreds of processes. Where bytecode is not kept (PYTHONDONTWRITEBYTECODE, which images of containers
# set), each would compile the package again, and each of pytest's workers all tests: that is a third of the time.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Machines that run tests are busy: how long an example takes says nothing.
settings.register_profile("dancedata", deadline=None)
settings.load_profile("dancedata")

# Tests compute as the command line does, in their own process, where they can replace functions. With this variable
# they keep the kernels that the processor or OPENBLAS_CORETYPE chooses: tests of numbers have to pass on all of them.
if not os.environ.get("DANCEDATA_TEST_NATIVE"):
    arithmetic.adopt()

# A shell without job control starts `pytest ... &` with SIGINT ignored, and processes that tests start inherit it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Processes that the server of forks starts have torch; by themselves each would import it, which takes two seconds.
multiprocessing.set_forkserver_preload(["torch", "tests.remote.children", *PACKAGES])

# pytest's workers share the cores: threads of torch that wait for each other would take most of their time.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np  # noqa: E402 (kernels are chosen before)

from dancedata.synthetic import motion, music  # noqa: E402

# No machine loses its power here, and thousands of waits for the disk take a tenth of the time. Bad files still fail.
os.fsync = lambda file: os.fstat(file if isinstance(file, int) else file.fileno()) and None


def _kept(function: Callable[..., Any]) -> Callable[..., Any]:
    """Keep the last results of a generator, which depend on its arguments alone; their arrays become read-only."""

    @lru_cache(maxsize=12)
    @wraps(function)
    def kept(*arguments: Any) -> Any:
        result = function(*arguments)
        for part in result if isinstance(result, tuple) else (result,):
            for value in vars(part).values():
                if isinstance(value, np.ndarray):
                    value.setflags(write=False)
        return result

    return kept


# Tests run hundreds of commands in their process, and Typer would make the whole command line anew for each.
typer.testing._get_command = lru_cache(typer.testing._get_command)  # type: ignore[attr-defined]

# Tests write the same few songs and dances hundreds of times.
music.make_song, motion.make_motion = _kept(music.make_song), _kept(motion.make_motion)

ROOT = Path(__file__).resolve().parent.parent
#: A compact set of reference outputs, part of the project; its README says what it holds.
DATA = ROOT / "tests" / "golden" / "data"
#: The whole set, and real recordings, which are not.
SHARED = Path(os.environ.get("DANCEDATA_SHARED", ROOT.parent / "shared"))
HAS_SHARED = (SHARED / "golden").is_dir()


def pytest_configure(config: pytest.Config) -> None:
    """Before pytest's workers start, compile librosa's kernels in one process: they would import librosa all at once.

    Once in an environment, as pytest's cache remembers.

    Importing it compiles some kernels already, at the top of test modules, where no lock can be held.
    """
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        kept = getattr(config, "cache", None)
        place = Path(str(find_spec("librosa").origin))
        compiled = [str(place), place.stat().st_mtime_ns, version("librosa"), version("numba")]
        if kept is None or kept.get("dancedata/kernels", None) != compiled:
            code = "from dancedata.audio._librosa import compile_kernels; compile_kernels()"
            subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
        if kept is not None:
            kept.set("dancedata/kernels", compiled)
    else:
        gc.disable()  # until all tests are collected: a tenth of that time


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give all tests of a module to one worker, which makes the module's fixtures once; modules in their order.

    The modules of `COSTLY` rooms go to one worker too, unless it is the others' only work.
    """
    if config.option.dist != "load":
        return None
    from xdist.scheduler import LoadFileScheduling

    owners: dict[str, Any] = {}

    class ByRoom(LoadFileScheduling):
        def _assign_work_unit(self, node: Any) -> None:
            def room(module: str) -> str:
                return Path(module).parent.name

            mine = (module for module in self.workqueue if owners.get(room(module), node) is node)
            module = next(mine, next(iter(self.workqueue)))
            if room(module) in COSTLY:
                owners.setdefault(room(module), node)
            self.workqueue.move_to_end(module, last=False)
            super()._assign_work_unit(node)

    config.option.loadscopereorder = False
    return ByRoom(config, log)


#: Rooms whose tests fork, and rooms whose packages make processes large: a fork costs by the memory of its process.
FIRST, LAST = ("readers", "augment"), ("hf", "jukebox")
#: Rooms for which a process compiles librosa's kernels, imports large parts of transformers, or starts two browsers.
COSTLY = ("audio", "hf", "scene", "viewer")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run tests that fork first, and those that import the largest packages last."""

    def place(item: pytest.Item) -> int:
        rooms = item.path.relative_to(ROOT).parts
        return (rooms[1] in LAST) - (rooms[1] in FIRST)

    items.sort(key=place)


def pytest_collection_finish() -> None:
    """Exclude modules and tests from garbage collection: a full pass over them takes about a second."""
    gc.freeze()
    gc.enable()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what needs the whole set, all of it for one reason at one place: one line of the summary."""
    if not HAS_SHARED and "shared" in getattr(item, "fixturenames", ()):
        pytest.skip(
            "real motions, BVH files and songs, and Jukebox's whole context: outside the project, "
            "see tests/golden/data/README.md"
        )


@pytest.fixture(scope="session")
def shared() -> Path:
    """The whole set of reference outputs, and real recordings; tests that need them skip without."""
    return SHARED


@pytest.fixture
def no_local_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove what a test registers."""
    from dancedata.core import plugin_files
    from dancedata.core.registry import PROTOCOLS, REGISTRIES

    for registry in (*REGISTRIES.values(), PROTOCOLS):
        registry.names()
        monkeypatch.setattr(registry, "_classes", dict(registry._classes))
    monkeypatch.setattr(plugin_files, "_files", {})


class Arrays(Mapping[str, np.ndarray]):
    """Arrays of a reference file. In the compact set some are thinned out; ``KEY@AXIS`` has the indices left."""

    def __init__(self, path: Path) -> None:
        with np.load(path) as file:
            self._all = dict(file)

    def __getitem__(self, key: str) -> np.ndarray:
        return self._all[key]

    def __iter__(self) -> Iterator[str]:
        return (key for key in self._all if "@" not in key)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def shape(self, key: str) -> tuple[int, ...]:
        """The reference's own shape."""
        shape = self._all.get(f"{key}@shape")
        return self[key].shape if shape is None else tuple(shape.tolist())

    def index(self, key: str, axis: int = 0) -> np.ndarray:
        """Origin of the entries along an axis."""
        return self._all.get(f"{key}@{axis}", np.arange(self.shape(key)[axis]))

    def pair(self, key: str, found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Results at the places of the reference, and the reference."""
        assert found.shape == self.shape(key)
        for axis in range(found.ndim):
            found = np.take(found, self.index(key, axis), axis=axis)
        return found, self[key]

    def rows(self, key: str, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """The places, counted from `start`, of the reference's rows in a slice, and these rows."""
        index = self.index(key)
        inside = (index >= start) & (index < stop)
        return index[inside] - start, self[key][inside]


#: The compact set, and the whole one where it is; the compact one is then a part of it.
SETS = [pytest.param("compact", marks=pytest.mark.nightly), "whole"] if HAS_SHARED else ["compact"]


class Peers:
    """Results of the peers on a small synthetic corpus, and the corpus."""

    def __init__(self, folder: Path, whole: bool) -> None:
        self.folder = folder
        self.whole = whole

    def __truediv__(self, name: str) -> Path:
        return self.folder / name

    def load(self, name: str) -> Arrays:
        """Arrays of a file."""
        return Arrays(self.folder / name)


def unpack(source: Path, target: Path) -> Path:
    """Unpack a folder of the compact set."""
    for path in sorted(p for p in source.rglob("*") if p.is_file()):
        out = target / path.relative_to(source)
        out.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix != ".xz":
            shutil.copyfile(path, out)
        elif path.name.endswith(".columns.xz"):
            columns = _columns(lzma.decompress(path.read_bytes()))
            np.save(out.with_name(path.name.removesuffix(".columns.xz") + ".npy"), columns)
        else:
            out.with_suffix("").write_bytes(lzma.decompress(path.read_bytes()))
    return target


def _columns(data: bytes) -> np.ndarray:
    """Columns (T, D) float32 of second differences of their bits: T and D, then all first bytes, and so on."""
    n_rows, n_columns = np.frombuffer(data[:16], "<i8")
    planes = np.frombuffer(data[16:], np.uint8).reshape(4, -1)
    bits = np.ascontiguousarray(planes.T).view(np.uint32).reshape(n_columns, n_rows).T
    for _ in range(2):
        bits = np.cumsum(bits, axis=0, dtype=np.uint32)
    return np.ascontiguousarray(bits).view(np.float32)


@pytest.fixture(scope="session", params=SETS)
def peers(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Peers:
    """The peers' outputs: the compact set, and the whole one where it is."""
    if request.param == "whole":
        return Peers(SHARED / "golden" / "peers", whole=True)
    return Peers(unpack(DATA / "peers", tmp_path_factory.mktemp("peers")), whole=False)


class MetricsGolden:
    """Results of the published programs' metrics for some dances and sets of features, and the inputs."""

    def __init__(self, folder: Path, whole: bool) -> None:
        self.folder, self.whole = folder, whole
        self.features, self.beats = self.arrays("features"), self.arrays("beats")

    def arrays(self, name: str) -> Arrays:
        """Arrays of a file."""
        return Arrays(self.folder / f"{name}.npz")

    def json(self, name: str) -> Any:
        """A file of values, with NaN."""
        return json.loads((self.folder / f"{name}.json").read_text())

    @cached_property
    def joints(self) -> dict[str, np.ndarray]:
        """Joint positions (T, J, 3) float32 by "KIND/CLIP"."""
        if self.whole:
            return dict(self.arrays("inputs"))
        files = sorted((self.folder / "inputs").rglob("*.npy"))
        return {f"{p.parent.name}/{p.stem}": np.load(p).reshape(-1, 24, 3) for p in files}


@pytest.fixture(scope="session", params=SETS)
def metrics_golden(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> MetricsGolden:
    """Outputs of the published metrics: the compact set, and the whole one where it is."""
    if request.param == "whole":
        return MetricsGolden(SHARED / "golden" / "metrics", whole=True)
    return MetricsGolden(unpack(DATA / "metrics", tmp_path_factory.mktemp("metrics")), whole=False)


@pytest.fixture(scope="session")
def crowd_golden(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], dict[str, np.ndarray]]:
    """Return a function that reads a file of outputs of programs for groups: the compact set."""
    folder = unpack(DATA / "crowd", tmp_path_factory.mktemp("crowd"))
    return lambda name: dict(np.load(folder / f"{name}.npz"))


@pytest.fixture(scope="session")
def jukebox_golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the reference's tiny Jukebox, its clips and its outputs."""
    return unpack(DATA / "jukebox", tmp_path_factory.mktemp("jukebox"))


Build = Callable[..., Any]
#: A folder by name, and what fills it.
Once = Callable[[str, Callable[[Path], object]], Path]
RECIPES = {"track": "aist++", "window": "aist++-edge-exact"}


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Return a function that makes a folder once per run, for all workers. Not to be written into."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base) / "once"
    shared.mkdir(exist_ok=True)

    def folder(name: str, fill: Callable[[Path], object]) -> Path:
        lock = open_locked(shared / f"{name}.lock")
        assert lock is not None
        try:
            if not (shared / f"{name}.done").exists():
                shutil.rmtree(shared / name, ignore_errors=True)
                (shared / name).mkdir()
                fill(shared / name)
                (shared / f"{name}.done").touch()
        finally:
            unlock(lock)
        return shared / name

    return folder


@pytest.fixture(scope="session")
def corpus(once: Once) -> Path:
    """Four clips of 6 s to two songs, official layout. Not to be written into."""
    from dancedata.synthetic import write_synthetic

    return (
        once("corpus", lambda folder: write_synthetic(folder / "source", songs=2, clips_per_song=2, clip_s=6))
        / "source"
    )


@pytest.fixture(scope="session")
def cache(once: Once) -> Path:
    """A cache that tests of all workers share."""
    return once("cache", lambda folder: None)


@pytest.fixture(autouse=True)
def _no_other_cache(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DANCEDATA_CACHE", str(cache))


@pytest.fixture(scope="session")
def run_build(cache: Path) -> Build:
    """Return a function that builds a recipe, given by name, with overrides as on the command line."""
    from dancedata.building.build import build
    from dancedata.recipes.parse import load_recipe

    def run(source: Path, out: Path, name: str = "aist++", set: Sequence[str] = (), **options: Any) -> Any:
        return build(load_recipe(name, set), source, out, **{"cache": cache, **options})

    return run


@pytest.fixture(scope="session")
def build_once(run_build: Build, once: Once) -> Callable[..., Path]:
    """Return a function that builds a recipe, given by name, with overrides; equal ones once in a run.

    A dataset that generates its source writes it into NAME-source next to the returned folder NAME. Neither is to be
    written into.
    """

    def build(name: str, source: Path | None = None, set: Sequence[str] = ()) -> Path:
        def fill(folder: Path) -> None:
            run_build(source or folder / f"{short}-source", folder / short, name, set)

        short = Path(name).stem
        key = hashlib.sha256(repr((name, source, list(set))).encode()).hexdigest()[:12]
        return once(f"{short}-{key}", fill) / short

    return build


@pytest.fixture(scope="session")
def built_in(build_once: Callable[..., Path], corpus: Path) -> dict[str, Path]:
    """The corpus built in both scopes. Not to be written into."""
    return {scope: build_once(recipe, corpus) for scope, recipe in RECIPES.items()}


@pytest.fixture(scope="session")
def built(built_in: dict[str, Path]) -> Path:
    """The corpus built in track scope. Not to be written into."""
    return built_in["track"]


@pytest.fixture(scope="session")
def random_store(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Return a function that puts a random store in a folder: written once for the same options, then copied."""
    from dancedata.testing.stores import write_random_store

    written: dict[str, Any] = {}

    def put(out: Path, **options: Any) -> Any:
        key = repr(sorted(options.items()))
        if key not in written:
            written[key] = write_random_store(tmp_path_factory.mktemp("random") / "store", **options)
        shutil.copytree(written[key].path, out, dirs_exist_ok=True)
        # Arrays too: tests bend them.
        return replace(copy.deepcopy(written[key]), path=out)

    return put


@pytest.fixture
def source(corpus: Path, tmp_path: Path) -> Path:
    """A copy of the corpus to bend."""
    return shutil.copytree(corpus, tmp_path / "source")


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Output folder; does not exist yet, in an empty folder."""
    return tmp_path / "outs" / "out"


@pytest.fixture
def built_copy(built: Path, out: Path) -> Path:
    """A built dataset to bend."""
    return shutil.copytree(built, out)


@pytest.fixture(scope="session")
def hashes() -> Callable[[Path], dict[str, str]]:
    """Return a function: SHA-256 of every file in a folder, by name."""
    return lambda folder: {p.name: sha256_file(p) for p in sorted(folder.iterdir()) if p.name != "local.json"}


@pytest.fixture(scope="session")
def rejects() -> Callable[[Path], list[dict[str, Any]]]:
    """Return a function: the rows of rejects.jsonl."""

    def read(out: Path) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (out / "rejects.jsonl").read_text(encoding="utf-8").splitlines()]

    return read

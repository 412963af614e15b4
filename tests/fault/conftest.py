"""A small corpus and a plug-in feature that takes its time, counts its calls, and kills its process on request."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.synthetic import write_synthetic
from tests.warm import Process

ROOT = Path(__file__).resolve().parents[2]
SONGS = 4
#: Prefix of the folders that joblib makes for large arguments, by default.
JOBLIB = "joblib_memmapping_folder"

#: The feature, installed as a third-party distribution. Files of the folder $SLOW control its side effects.
FEATURE = '''
import os, signal, time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from dancedata.core.columns import Columns, Group
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import AudioFeature
from dancedata.core.registry import FEATURES


@FEATURES.register("slow")
@dataclass(frozen=True)
class Slow(AudioFeature):
    """Time, and a number that identifies the signal."""

    version: ClassVar[int] = 1
    packages: ClassVar[tuple[str, ...]] = ("numpy",)

    @property
    def columns(self):
        return Columns((Group("time", 1, "s"), Group("signal", 1, "1")))

    def n_rows(self, n_samples, sample_rate, grid):
        return FrameGrid.of(sample_rate).resampled_length(n_samples, grid)

    def extract(self, signal, grid, *, start_bpm=None):
        name = signal.sha256[:6]
        folder = Path(os.environ["SLOW"])
        with open(folder / "log", "a") as log:
            log.write(f"start {name}\\n")
        kill(folder / f"kill-once-{name}", True)
        kill(folder / f"kill-{name}", False)
        if (folder / f"kill-writing-{name}").exists():
            (folder / f"kill-writing-{name}").unlink()
            os.replace = die
        time.sleep(float((folder / "seconds").read_text()))
        rows = np.empty((self.n_rows(signal.n_samples, signal.sample_rate, grid), 2), np.float32)
        rows[:, 0] = np.arange(len(rows)) / float(grid.rate)
        rows[:, 1] = int(name, 16)
        return rows


def kill(order, once):
    if order.exists():
        if once:
            order.unlink()
        die()


def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)
'''
RECIPE = """
recipe: 1
name: faults
dataset: {aist++: {}}
windows: {length_s: 5, stride_s: 0.5}
motion: {edge151: {}}
audio: {slow: {}}
"""


class Slow:
    """The installed feature, and a folder to tell it what to do and to read what it did."""

    def __init__(self, folder: Path, cache: Path, recipe: Path, site: Path) -> None:
        self.folder, self.cache, self.recipe = folder, cache, recipe
        self.tmp = folder / "tmp"
        self.tmp.mkdir()
        paths = [str(site), str(ROOT), os.environ.get("PYTHONPATH", "")]
        self.environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(paths),
            "DANCEDATA_CACHE": str(cache),
            "SLOW": str(folder),
            "TMPDIR": str(self.tmp),
            # Workers of Dask and loky write no compiled code.
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        self.pids: list[int] = []
        self.sleep(0)

    def sleep(self, seconds: float) -> None:
        """Say how long a song takes."""
        (self.folder / "seconds").write_text(str(seconds))

    def command(self, *arguments: object) -> list[str]:
        """Return the command line of `dancedata build` for this recipe."""
        return [sys.executable, "-m", "dancedata", "build", str(self.recipe), "--quiet", *map(str, arguments)]

    def build(self, source: Path, out: Path, *arguments: object, code: int = 0) -> str:
        """Run a build to its end, check its exit code, and return what it printed."""
        process = self.start(source, out, *arguments)
        printed, errors = process.communicate()
        assert process.returncode == code, f"{process.returncode}: {printed}{errors}"
        assert "Traceback" not in errors, errors
        return str(printed + errors)

    def start(self, source: Path, out: Path, *arguments: object, **options: Any) -> Process:
        """Begin a build, in a process that has imported everything."""
        process = Process(self.command(source, "--out", out, *arguments), self.environment, **options)
        self.pids.append(process.pid)
        return process

    def start_cold(self, source: Path, out: Path, *arguments: object, **options: Any) -> subprocess.Popen[Any]:
        """Begin a build as a shell does."""
        command = self.command(source, "--out", out, *arguments)
        process = subprocess.Popen(command, env=self.environment, **options)
        self.pids.append(process.pid)
        return process

    def log(self, *lines: str) -> list[str]:
        """Add lines to the log of calls; returns all of it."""
        path = self.folder / "log"
        with path.open("a") as log:
            log.writelines(f"{line}\n" for line in lines)
        return path.read_text().splitlines()

    def calls(self) -> list[str]:
        """Return the songs that were computed, one entry a call."""
        return [line.removeprefix("start ") for line in self.log() if line.startswith("start ")]

    def published(self) -> set[str]:
        """Return the songs whose features are in the cache."""
        rows = [np.load(path, mmap_mode="r")[0, 1] for path in (self.cache / "features").rglob("*.npy")]
        return {f"{int(number):06x}" for number in rows}

    def entries(self) -> dict[str, int]:
        """Return the arrays in the cache and the inode of each: one that is published again has another."""
        return {str(path.relative_to(self.cache)): path.stat().st_ino for path in self.cache.rglob("*.npy")}

    def strays(self) -> list[str]:
        """Return temporary files and locks: in the cache, in $TMPDIR, and joblib's in shared memory."""
        folders = [self.cache / "tmp", self.cache / "locks", self.tmp]
        # A cluster's own folder is not the build's.
        paths = [path for folder in folders if folder.exists() for path in folder.iterdir()]
        found = [str(path) for path in paths if path.name != "dask-scratch-space"]
        return found + [str(path) for pid in self.pids for path in Path("/dev/shm").glob(f"{JOBLIB}_{pid}_*")]


@pytest.fixture(scope="session")
def corpus(once: Callable[..., Path]) -> Path:
    """Eight clips of 6 s to four songs. Not to be written into."""
    sizes = {"songs": SONGS, "clips_per_song": 2, "clip_s": 6}
    return once("fault-corpus", lambda folder: write_synthetic(folder / "source", **sizes)) / "source"


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the feature as an installed distribution."""
    site = tmp_path_factory.mktemp("site")
    info = site / "slow_feature-1.0.dist-info"
    info.mkdir()
    (site / "slow_feature.py").write_text(FEATURE, encoding="utf-8")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: slow-feature\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[dancedata.audio]\nslow = slow_feature\n")
    return site


@pytest.fixture(scope="session")
def make_slow(site: Path) -> Callable[[Path], Slow]:
    """Return a function that makes a cache, a recipe and a log in a folder."""

    def make(folder: Path) -> Slow:
        (folder / "slow").mkdir(parents=True)
        recipe = folder / "recipe.yaml"
        recipe.write_text(RECIPE, encoding="utf-8")
        return Slow(folder / "slow", folder / "cache", recipe, site)

    return make


@pytest.fixture
def slow(make_slow: Callable[[Path], Slow], tmp_path: Path) -> Slow:
    """The feature with a separate cache."""
    return make_slow(tmp_path)


@pytest.fixture(scope="session")
def undisturbed(make_slow, corpus, once, hashes):
    """Hashes of a dataset that one process built without being disturbed."""

    def fill(folder: Path) -> None:
        slow = make_slow(folder)
        slow.build(corpus, folder / "out", "--jobs", 1)
        assert len(slow.calls()) == SONGS

    return hashes(once("undisturbed", fill) / "out")


@pytest.fixture
def songs(corpus: Path) -> Sequence[str]:
    """Names of the songs as the log has them."""
    from dancedata.music.signal import load_audio

    return [load_audio(path).sha256[:6] for path in sorted((corpus / "wavs").glob("*.wav"))]

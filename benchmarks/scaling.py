"""Scaling of builds: clips per second with 1 and 2 jobs, overhead per unit of work, and a corpus of 100,000 clips.

    python benchmarks/scaling.py throughput          # the demo's feature and representation
    python benchmarks/scaling.py units               # cost of scheduling, cache and publishing per unit
    python benchmarks/scaling.py clusters [ROUNDS]   # cost of scheduling per unit on each engine
    python benchmarks/scaling.py corpus [N ...]      # default 1000 10000 100000 clips of four frames

It prints measurements and asserts nothing. Only times of the same machine are comparable.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import wave
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, ClassVar

import numpy as np

from dancedata.building.build import build
from dancedata.building.clips import compute_clips, sources_of
from dancedata.building.plan import make_plan
from dancedata.core.clip import ClipRef, Scan
from dancedata.core.columns import Columns, Group
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import AudioFeature, Dataset, Representation
from dancedata.core.registry import DATASETS, FEATURES, REPRESENTATIONS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.execution.cache import Cache
from dancedata.execution.executors import Executor
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units, start_workers
from dancedata.recipes.parse import load_recipe, parse_recipe
from dancedata.recipes.recipe import Recipe

FRAMES, SAMPLE_RATE, CLIPS_PER_SONG = 4, 8000, 100


@DATASETS.register("many")
@dataclass(frozen=True)
class Many(Dataset):
    """Clips of four frames, one file per clip, and one song per hundred clips."""

    version: ClassVar[int] = 1
    licence: ClassVar[str] = "CC0-1.0"
    citation: ClassVar[str] = "made by a benchmark"

    def scan(self, source: Path) -> Scan:
        """List the clips of write_corpus."""
        n = json.loads((source / "n.json").read_text())
        refs = tuple(
            ClipRef(
                f"c{i:06d}",
                source / f"{i // 1000:03d}" / f"{i:06d}.bin",
                source / "music" / f"{i // CLIPS_PER_SONG:04d}.wav",
                "train",
                music=f"s{i // CLIPS_PER_SONG:04d}",
                tempo_bpm=120.0,
            )
            for i in range(n)
        )
        return Scan("many", refs)

    def load(self, ref: ClipRef) -> Motion:
        """Make a motion of the number in the file."""
        number = int(ref.motion_path.read_bytes())
        translation = np.full((FRAMES, 3), number, np.float64)
        return Motion(translation, np.zeros((FRAMES, 24, 3)), FrameGrid.of(30), SMPL24)

    def make_example(self, folder: Path) -> None:
        """Write three clips."""
        write_corpus(folder, 3)


@REPRESENTATIONS.register("place")
@dataclass(frozen=True)
class Place(Representation):
    """The position of the root."""

    version: ClassVar[int] = 1
    axes: ClassVar[str] = "as given"

    @property
    def skeleton(self) -> Skeleton:
        """The motion's own."""
        return SMPL24

    @property
    def columns(self) -> Columns:
        """Three."""
        return Columns((Group("place", 3, "m"),))

    def encode(self, motion: Motion, contacts: Any = None) -> Any:
        """Return the translation."""
        return motion.translation.astype(np.float32)


@FEATURES.register("level")
@dataclass(frozen=True)
class Level(AudioFeature):
    """One column with the mean level."""

    version: ClassVar[int] = 1
    packages: ClassVar[tuple[str, ...]] = ("numpy",)

    @property
    def columns(self) -> Columns:
        """One."""
        return Columns((Group("level", 1, "1"),))

    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Count rows."""
        return FrameGrid.of(sample_rate).resampled_length(n_samples, grid)

    def extract(self, signal: Any, grid: FrameGrid, *, start_bpm: float | None = None) -> Any:
        """Return a constant."""
        rows = self.n_rows(signal.n_samples, signal.sample_rate, grid)
        return np.full((rows, 1), float(np.abs(signal.samples).mean()), np.float32)


RECIPE = {
    "recipe": 1,
    "name": "many",
    "dataset": {"many": {}},
    "windows": {"length_frames": 2, "stride_frames": 1},
    "motion": {"place": {}},
    "audio": {"level": {}},
}


def write_corpus(source: Path, n: int) -> Path:
    """Write n clips."""
    (source / "music").mkdir(parents=True)
    for i in range(0, n, 1000):
        (source / f"{i // 1000:03d}").mkdir()
    for i in range(n):
        (source / f"{i // 1000:03d}" / f"{i:06d}.bin").write_bytes(str(i).encode())
    for i in range(0, n, CLIPS_PER_SONG):
        with wave.open(str(source / "music" / f"{i // CLIPS_PER_SONG:04d}.wav"), "wb") as file:
            file.setnchannels(1)
            file.setsampwidth(2)
            file.setframerate(SAMPLE_RATE)
            rng = np.random.default_rng(i)
            file.writeframes(rng.integers(-9999, 9999, SAMPLE_RATE // 2, dtype=np.int16).tobytes())
    (source / "n.json").write_text(str(n))
    return source


def corpus(n: int) -> None:
    """Build n tiny clips, stage by stage, in a separate process: memory is that of this corpus alone."""
    with tempfile.TemporaryDirectory(prefix="scaling-") as name:
        folder = Path(name)
        source = write_corpus(folder / "source", n)
        recipe, cache, quiet = parse_recipe(RECIPE), Cache(folder / "cache"), Progress(quiet=True)
        before = _peak_mb()

        def staged(label: str, call: Callable[[], Any]) -> Any:
            begun, begun_cpu = time.perf_counter(), time.process_time()
            result = call()
            spent, cpu = time.perf_counter() - begun, time.process_time() - begun_cpu
            print(
                f"{n:>7} clips  {label:<30} {spent:8.2f} s, CPU {cpu:8.2f} s: {cpu / n * 1e3:7.3f} ms per clip  "
                f"{_peak_mb():6.0f} MB",
                flush=True,
            )
            return result

        scan = staged("scan", lambda: recipe.dataset.scan(source))
        staged("plan: lengths of all", lambda: make_plan(recipe, source))
        for turn in ("cold", "warm"):
            sources = staged(f"identify, {turn}", lambda: sources_of(cache, recipe, scan, jobs=1, progress=quiet))
            staged(f"units, {turn}", lambda s=sources: compute_clips(cache, recipe, s, jobs=1, progress=quiet))
        options: dict[str, Any] = {"cache": folder / "cache"}
        staged("whole build from the cache", lambda: build(recipe, source, folder / "out", **options))
        staged("the same again: nothing to do", lambda: build(recipe, source, folder / "out", **options))
        entries = sum(1 for _ in (folder / "cache").rglob("*.*"))
        print(f"{n:>7} clips  {entries} entries in the cache; {before:.0f} MB before the first stage")


def units(n: int = 2000) -> None:
    """Print the overhead per unit: of the pool, of the cache, of publishing."""
    with tempfile.TemporaryDirectory(prefix="scaling-") as name:
        cache, quiet = Cache(Path(name)), Progress(quiet=True)
        row = np.zeros((150, 151), np.float32)

        def per_unit(label: str, call: Callable[[], Any]) -> None:
            begun = time.perf_counter()
            call()
            print(f"{label:<58} {(time.perf_counter() - begun) / n * 1e6:8.1f} us per unit")

        keys = [Cache.key("x", number=i) for i in range(n)]
        run_units(abs, [(1,)] * 20, jobs=2, label="", progress=quiet)  # starts the pool
        for jobs in (1, 2):
            calls = [(-i,) for i in range(n)]
            per_unit(
                f"scheduling, {jobs} job{'s' * (jobs > 1)}",
                lambda c=calls, j=jobs: run_units(abs, c, jobs=j, label="", progress=quiet),
            )
        per_unit("key", lambda: [Cache.key("x", number=i) for i in range(n)])
        per_unit("looking up missing entries", lambda: [cache.array("a", k) for k in keys])
        per_unit("publishing 90 kB", lambda: [cache.put_array("a", k, row, durable=False) for k in keys])
        per_unit("publishing 90 kB, lock and second lookup", lambda: [cache.once("b", k, lambda: row) for k in keys])
        per_unit("looking up existing entries", lambda: [cache.array("a", k) for k in keys])
        per_unit("reading 90 kB, checksum compared", lambda: [np.asarray(cache.array("a", k)) for k in keys])
        per_unit("publishing JSON", lambda: [cache.put_json("j", k, [1, "30", []]) for k in keys])
        per_unit("reading JSON", lambda: [cache.json("j", k) for k in keys])
        few = keys[:100]
        begun = time.perf_counter()
        for k in few:
            cache.put_array("d", k, row, durable=True)
        spent = (time.perf_counter() - begun) / len(few) * 1e6
        print(f"{'publishing 90 kB, flushed to disk (units above 0.5 s)':<58} {spent:8.1f} us per unit")


ENGINES = ("processes", "tcp", "ray://auto")


def clusters(rounds: int = 3) -> None:
    """Print the cost of scheduling a unit on each engine with two workers, in turn, and as a multiple of processes'.

    Units do nothing, or sleep 50 ms: then, how much longer the stage takes than half of the sum.
    """
    spent: dict[str, list[tuple[float, float]]] = {engine: [] for engine in ENGINES}
    with tempfile.TemporaryDirectory(prefix="scaling-") as name, ExitStack() as stack:
        executors = {}
        for engine in ENGINES:
            try:
                scheduler = _cluster(engine, stack)
                started = start_workers(2, Cache(Path(name)), Path(name), set(), scheduler=scheduler)
                executors[engine] = stack.enter_context(started)
            except ImportError as error:
                print(f"{engine:<18} left out: {error}")
        for turn in range(rounds + 1):
            for engine, executor in executors.items():
                empty, sleeping = (500, 80) if turn else (20, 4)  # the first turn starts workers
                costs = (_timed(abs, -1, empty, executor) / empty, _timed(time.sleep, 0.05, sleeping, executor))
                spent[engine] += [costs] * bool(turn)
        base = median(cost for cost, _ in spent["processes"])
        for engine in executors:
            cost, total = (median(times) for times in zip(*spent[engine], strict=True))
            ideal = 80 / 2 * 0.05
            print(
                f"{engine:<18} empty unit {cost * 1e3:8.2f} ms, {cost / base:6.1f} times processes;  "
                f"units of 50 ms: {100 * (total / ideal - 1):5.1f} % above two workers without cost"
            )


def _cluster(engine: str, stack: ExitStack) -> str | None:
    """Start a cluster of two workers here; returns its address."""
    if engine == "tcp":
        from distributed import LocalCluster

        cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
        return str(stack.enter_context(cluster).scheduler_address)
    if engine == "ray://auto":
        import ray

        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
        stack.callback(ray.shutdown)
    return None if engine == "processes" else engine


def _timed(function: Callable[[Any], Any], argument: Any, n: int, executor: Executor) -> float:
    begun = time.perf_counter()
    run_units(function, [(argument,)] * n, jobs=executor, label="x", progress=Progress(quiet=True), exact=False)
    return time.perf_counter() - begun


def throughput(songs: int = 20, clips: int = 8) -> None:
    """Build a synthetic corpus with 1 and 2 jobs, and again from the cache."""
    settings = [f"dataset.synthetic.songs={songs}", f"dataset.synthetic.clips_per_song={clips}"]
    recipe: Recipe = load_recipe("demo", settings)
    total = songs * clips
    with tempfile.TemporaryDirectory(prefix="scaling-") as name:
        folder = Path(name)
        # Workers start and librosa's kernels load before the clock starts.
        build(recipe, folder / "source", folder / "out", jobs=2, cache=folder / "cache")
        rates = {}
        for jobs in (1, 2):
            shutil.rmtree(folder / "out")
            begun = time.perf_counter()
            build(recipe, folder / "source", folder / "out", jobs=jobs, cache=folder / f"cache-{jobs}")
            rates[jobs] = total / (time.perf_counter() - begun)
        shutil.rmtree(folder / "out")
        begun = time.perf_counter()
        build(recipe, folder / "source", folder / "out", jobs=1, cache=folder / "cache-1")
        cached = time.perf_counter() - begun
    print(f"1 job {rates[1]:.2f} clips/s; 2 jobs {rates[2]:.2f} clips/s, {rates[2] / rates[1]:.2f} times as many")
    share = cached / total * rates[1]
    print(f"from the cache {total / cached:.1f} clips/s: {100 * share:.1f} % of the time of a build with 1 job")


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Run the chosen benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["throughput", "units", "clusters", "corpus"])
    parser.add_argument("n", nargs="*", type=int)
    given = parser.parse_args()
    if given.what == "corpus" and len(given.n) != 1:
        for n in given.n or (1000, 10_000, 100_000):
            subprocess.run([sys.executable, __file__, "corpus", str(n)], check=True)
    elif given.what == "corpus":
        corpus(given.n[0])
    elif given.what == "units":
        units()
    elif given.what == "clusters":
        clusters(*given.n)
    else:
        throughput()


if __name__ == "__main__":
    main()

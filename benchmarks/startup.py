"""Start-up: overhead of commands, of a build of three windows, and of a worker process.

    python benchmarks/startup.py                      # ten rounds
    python benchmarks/startup.py --rounds 3
    python benchmarks/startup.py --package DIR        # of another checkout, such as one of an earlier commit

Each case is a separate process, and the cases alternate, so that a busy phase of the machine affects all of them.
Printed are the minimum and the median over rounds of the wall time and of the CPU time (user and system, with all
descendants, by `getrusage`), and the medians as multiples of a peer in the same rounds:
`python -c "import numpy, h5py"`, the least that a program pays which reads HDF5. Python's compiled files (.pyc)
exist, as after an installation: a round before the first is not counted.

A build is by the command line, of a corpus that exists: three clips of one window each with the fields edge151 and
librosa35; "cold" with an empty cache, "cached" with all units in the cache and no dataset in OUT. A worker "loads a
unit" when it unpickles one, which imports what the unit needs, except for what its functions import when they are
called, such as scipy.fft; "runs a unit" is all of it.
"""

from __future__ import annotations

import argparse
import os
import pickle
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from features import print_machine

PEER = "python -c 'import numpy, h5py'"
CORPUS = """recipe: 1
name: corpus
dataset: {synthetic: {songs: 2, clips_per_song: 2, clip_s: 5, split: all}}
windows: {length_s: 5, stride_s: 0.5}
motion: {edge151: {}}
"""
RECIPE = """recipe: 1
name: tiny
dataset: aist++
windows: {length_s: 5, stride_s: 0.5}
motion: {edge151: {}}
audio: {librosa35: {}}
"""
UNIT = (
    "import pickle, sys\nfunction, call = pickle.load(open(sys.argv[1], 'rb'))\nif len(sys.argv) > 2: function(*call)"
)


@dataclass
class Case:
    """Something to run: arguments for Python, and what has to be done before each run.

    Attributes
    ----------
    wall_s, cpu_s
        Of each round.
    """

    name: str
    arguments: list[str]
    prepare: Callable[[], None] = lambda: None
    wall_s: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)

    def run(self, environment: dict[str, str]) -> None:
        """Run it once, and note its times."""
        self.prepare()
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([sys.executable, *self.arguments], check=True, capture_output=True, env=environment)
        self.wall_s.append(time.perf_counter() - begun)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.cpu_s.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def cases(folder: Path) -> list[Case]:
    """Return all cases; their files are in a folder."""
    command = ["-m", "dancedata"]
    found = [
        Case("python -c pass", ["-c", "pass"]),
        Case(PEER, ["-c", "import numpy, h5py"]),
        Case("import dancedata", ["-c", "import dancedata"]),
        Case("import dancedata.torch", ["-c", "import dancedata.torch"]),
        Case("dancedata --version", [*command, "--version"]),
        Case("dancedata --help", [*command, "--help"]),
        Case("dancedata build --help", [*command, "build", "--help"]),
        Case("dancedata info plugins", [*command, "info", "plugins"]),
    ]
    for jobs in (1, 2):
        build = [*command, "build", str(folder / "tiny.yaml"), str(folder / "source"), "--quiet"]
        build += ["--out", str(folder / "out"), "--cache", str(folder / f"cache-{jobs}"), "--jobs", str(jobs)]
        name = f"build of 3 windows, {jobs} job{'s' * (jobs > 1)}"
        found.append(Case(f"{name}, cold", build, _removes(folder / "out", folder / f"cache-{jobs}")))
        found.append(Case(f"{name}, cached", build, _removes(folder / "out")))
    return found


def _removes(*folders: Path) -> Callable[[], None]:
    def remove() -> None:
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)

    return remove


def worker_cases(folder: Path) -> list[Case]:
    """Return what workers do: load a unit, and run it."""
    from dancedata.building.clips import sources_of
    from dancedata.building.compute import make, units_of
    from dancedata.building.measuring import takes_of
    from dancedata.execution.cache import Cache
    from dancedata.execution.progress import Progress
    from dancedata.recipes.parse import load_recipe

    recipe, cache = load_recipe(folder / "tiny.yaml"), Cache(folder / "worker")
    quiet, scan = Progress(quiet=True), recipe.dataset.scan(folder / "source")
    sources = sources_of(cache, recipe, replace(scan, clips=scan.clips[:1]), jobs=1, progress=quiet)
    (take,), _ = takes_of(cache, recipe.dataset, sources, jobs=1, progress=quiet)
    motion, music = (f for f in recipe.parts.fields if f.kind in ("motion", "audio"))
    found = []
    for name, maker in (("motion", motion), ("librosa35", music)):
        (unit,) = units_of([maker], [((maker.id, ""), maker.asks(take))])
        (folder / name).write_bytes(pickle.dumps((make, (cache, unit))))
        arguments = ["-c", UNIT, str(folder / name)]
        found.append(Case(f"a worker loads a unit: {name}", arguments))
        found.append(Case(f"a worker runs a unit: {name}", [*arguments, "run"], _removes(folder / "worker")))
    return found


def print_table(done: list[Case]) -> None:
    """Print a row for each case."""
    (peer,) = (case for case in done if case.name == PEER)
    wall, cpu = statistics.median(peer.wall_s), statistics.median(peer.cpu_s)
    print(
        "| seconds | wall: min, median | times the peer | CPU: min, median | times the peer |\n|---|---|---|---|---|"
    )
    for case in done:
        own_wall, own_cpu = statistics.median(case.wall_s), statistics.median(case.cpu_s)
        print(
            f"| {case.name} | {min(case.wall_s):.2f}, {own_wall:.2f} | {own_wall / wall:.2f} "
            f"| {min(case.cpu_s):.2f}, {own_cpu:.2f} | {own_cpu / cpu:.2f} |"
        )


def main() -> None:
    """Run all cases interleaved and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--package", type=Path, help="checkout whose dancedata is measured, without its workers")
    given = parser.parse_args()
    checkout = (given.package or Path(__file__).parents[1]).resolve()
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"} | {
        "PYTHONPATH": str(checkout)
    }
    print_machine()
    with tempfile.TemporaryDirectory(prefix="startup-") as name:
        folder = Path(name)
        (folder / "corpus.yaml").write_text(CORPUS, encoding="utf-8")
        (folder / "tiny.yaml").write_text(RECIPE, encoding="utf-8")
        make = [
            "-m",
            "dancedata",
            "build",
            "--dry-run",
            str(folder / "corpus.yaml"),
            str(folder / "source"),
            "--quiet",
        ]
        Case("corpus", make).run(environment)
        min((folder / "source" / "motions").iterdir()).unlink()  # four clips, of which three are enough
        every = cases(folder) + ([] if given.package else worker_cases(folder))
        for number in range(given.rounds + 1):
            for case in every:
                case.run(environment)
                if not number:
                    case.wall_s.clear()
                    case.cpu_s.clear()
        print(f"{given.rounds} rounds; load at the end {os.getloadavg()[0]:.1f}")
        print_table(every)


if __name__ == "__main__":
    main()

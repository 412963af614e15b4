"""Every command that writes, killed at random: the group, the parent, a worker, or stopped and then killed or woken.

    python -m pytest -m nightly tests/fault/test_every_kill.py     200 kills; prints how many of each kind there were

Afterwards every output is byte-identical to that of an undisturbed run, or untouched; foreign files stay. Builds and
conversions take minutes here: by default test_kills, execution/test_foreign_files and files/test_publish kill them.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.execution.cache import Cache
from dancedata.execution.cache_admin import entries, prune, verify_cache
from dancedata.store import open_store

SONG_S = 0.2
RECIPE = """
recipe: 1
name: kills
dataset: {aist++: {}}
windows: {length_s: 5, stride_s: STRIDE}
motion: {edge151: {}, lodge139: {}}
keymotion: {lodge: {}}
audio: {slow: {}}
augment: {mirror: true}
store: {shard_mb: 1}
"""
HEX = "0123456789abcdef" * 4
#: Foreign files in the cache and next to OUT, with names that look like ours.
FOREIGN = {
    "cache": ["notes.txt", "tmp/a.tmp", f"tmp/{HEX[:32]}.tmp", "locks/build-1", f"features/01/{HEX}.txt"],
    "outs": [".out.new/thesis.tex", ".out.old/dataset.json", ".dancedata-out.new-01234567/thesis.tex", "out.lock"],
}
WAYS = ("group", "parent", "worker", "stopped and killed", "stopped and woken")
#: Of commands that start no workers, or have nothing for them to do.
NO_WORKERS = tuple(way for way in WAYS if way != "worker")
CACHE = [sys.executable, "-m", "dancedata", "cache"]


@dataclass
class Hunter:
    """Starts commands and kills them; knows how often and how."""

    environment: dict[str, str]
    chance: random.Random
    output: Path
    orphans: set[tuple[int, str]] = field(default_factory=set)
    kills: Counter[tuple[str, str]] = field(default_factory=Counter)

    def run(self, kind, command, longest, ways, *, meanwhile=None, codes=(0,)):
        """Run a command and kill it in one of the ways, each in turn; tells whether it ended well all the same.

        Parameters
        ----------
        longest
            Seconds that it takes undisturbed; it is killed within that time, but not while Python starts.
        meanwhile
            Called while it is stopped.
        codes
            Exit codes of a good end.
        """
        way = self.next_way(ways)
        # Into a file: workers that outlive their parent hold a pipe open.
        with self.output.open("w") as output:
            options: dict[str, Any] = {"stdout": output, "stderr": output, "start_new_session": True}
            process = subprocess.Popen(list(map(str, command)), env=self.environment, **options)
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=self.chance.uniform(0.25, 1.0) * longest)
        struck = process.poll() is None and self._strike(process, way, meanwhile)
        try:
            process.wait(timeout=120)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)  # shows where it waits
            process.wait()
            raise AssertionError(f"{kind}, {way}: it does not end: {self.output.read_text()}") from None
        if struck:
            self.kills[kind, way] += 1
        if process.returncode == -signal.SIGKILL:
            assert struck
            return False
        assert process.returncode in codes, f"{kind}, {way}: {process.returncode}: {self.output.read_text()}"
        return True

    def next_way(self, ways: tuple[str, ...]) -> str:
        """Return the way of the next kill: each in turn."""
        return ways[self.kills.total() % len(ways)]

    def _strike(self, process: subprocess.Popen[bytes], way: str, meanwhile: Any) -> bool:
        """Kill; tells whether anything was hit."""
        self.orphans |= {(pid, start_of(pid)) for pid in descendants(process.pid)}
        if way == "worker":
            worker = self._worker(process)
            if worker is not None:
                with suppress(ProcessLookupError):
                    os.kill(worker, signal.SIGKILL)
            return worker is not None
        if way == "parent":
            process.send_signal(signal.SIGKILL)
            return True
        if way != "group":
            os.killpg(process.pid, signal.SIGSTOP)
            time.sleep(0.2)
            if meanwhile is not None:
                meanwhile()
        os.killpg(process.pid, signal.SIGCONT if way == "stopped and woken" else signal.SIGKILL)
        return True

    def _worker(self, process: subprocess.Popen[bytes]) -> int | None:
        """Wait for a worker process and return one; None if the command ends without any."""
        while process.poll() is None:
            workers = [pid for pid in descendants(process.pid) if b"popen_loky" in command_of(pid)]
            if workers:
                time.sleep(self.chance.uniform(0, 0.3))
                return self.chance.choice(workers)
            time.sleep(0.02)
        return None


def start_of(pid: int) -> str:
    """Return when a process began, which tells it from a later one of the same number; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
    except OSError:
        return ""


def command_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def descendants(pid: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError, IndexError):
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            if parent == pid:
                found += [int(stat.parent.name), *descendants(int(stat.parent.name))]
    return found


def undisturbed(command: list[Any], environment: dict[str, str]) -> float:
    """Run a command to its end, and return how long that took."""
    begun = time.monotonic()
    done = subprocess.run(list(map(str, command)), env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return time.monotonic() - begun


def plant(folder: Path, kind: str) -> Callable[[], None]:
    """Create foreign files; return a function that checks that they are unchanged."""

    def state() -> dict[str, Any]:
        found = {name: (folder / name).lstat() for name in FOREIGN[kind]}
        return {n: (s.st_ino, s.st_mtime_ns, (folder / n).read_text()) for n, s in found.items()}

    for name in FOREIGN[kind]:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("somebody's")
    before = state()

    def check() -> None:
        assert state() == before

    return check


def beside(out: Path) -> set[str]:
    """Return the entries next to OUT that are not foreign files."""
    return {p.name for p in out.parent.iterdir()} - {Path(n).parts[0] for n in FOREIGN["outs"]} - {out.name}


@pytest.fixture(params=[pytest.param(1, id="one kill"), pytest.param(20, marks=pytest.mark.nightly, id="20 kills")])
def cache_kills(request: pytest.FixtureRequest) -> int:
    """Number of kills of a command of the cache."""
    return int(request.param)


@pytest.fixture
def hunter(slow: Any, request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    """A hunter whose moments depend on the test alone."""
    slow.environment["PYTHONFAULTHANDLER"] = "1"
    hunter = Hunter(slow.environment, random.Random(request.node.name), tmp_path / "said")
    yield hunter
    # Workers that outlive their parent wait minutes for work before they end.
    for pid, start in hunter.orphans:
        if start and start_of(pid) == start:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    for (kind, way), n in sorted(hunter.kills.items()):
        print(f"{kind}: {way}: {n}")


@pytest.fixture
def recipes(slow: Any, tmp_path: Path) -> list[Path]:
    """Two recipes with mirrored copies and key motions, which share all units of work."""
    slow.sleep(SONG_S)
    found = [tmp_path / f"recipe{k}.yaml" for k in range(2)]
    for path, stride in zip(found, ("0.5", "1"), strict=True):
        path.write_text(RECIPE.replace("STRIDE", stride), encoding="utf-8")
    return found


@pytest.fixture
def command(slow: Any, corpus: Path, out: Path) -> Callable[..., list[Any]]:
    """Return a function: the command line that builds a recipe with two workers."""

    def line(recipe: Path, *options: str) -> list[Any]:
        slow.recipe = recipe
        return list(slow.command(corpus, "--out", out, "--jobs", 2, *options))

    return line


@pytest.mark.nightly
def test_builds(slow: Any, hunter: Hunter, recipes: list[Path], command: Any, out: Path, hashes: Any):
    checks = [plant(slow.cache, "cache"), plant(out.parent, "outs")]
    build = command(recipes[0])
    computing = undisturbed(build, slow.environment)
    shutil.rmtree(out)
    writing = undisturbed(build, slow.environment)
    wanted = hashes(out)
    assert sum(name.startswith("train-") for name in wanted) > 1
    with open_store(out) as ds:
        assert "lodge" in ds.fields
        assert any(clip.source for clip in ds)
    shutil.rmtree(out)
    published: dict[str, int] = {}

    def meanwhile() -> None:
        """Another build into OUT, and pruning of all that is not in use."""
        other = subprocess.run(list(map(str, build)), env=slow.environment, capture_output=True, text=True)
        assert other.returncode == 0 or "another build is writing there" in other.stderr
        prune(slow.cache, max_bytes=0)
        published.clear()

    while hunter.kills.total() < 70:
        anew = not hunter.kills.total() % 3 or hunter.next_way(WAYS) == "worker"
        if anew:  # otherwise only interrupted units and writing remain
            remove_entries(slow.cache)
            published.clear()
        if hunter.run("build", build, computing if anew else writing, WAYS, meanwhile=meanwhile):
            assert hashes(out) == wanted
            shutil.rmtree(out)
        elif (out / "dataset.json").exists():
            assert hashes(out) == wanted
        assert slow.entries().items() >= published.items(), "a unit was published again"
        published = slow.entries()
    undisturbed(build, slow.environment)
    assert hashes(out) == wanted
    assert verify_cache(slow.cache)[1] == []
    assert beside(out) == set()
    for check in checks:
        check()
    assert leftovers(slow) == []


def remove_entries(cache: Path) -> None:
    for entry in list(entries(cache)):
        entry.path.unlink()


def leftovers(slow: Any) -> list[str]:
    foreign = {str(slow.cache / name) for name in FOREIGN["cache"]}
    return [path for path in slow.strays() if path not in foreign]


@pytest.mark.nightly
def test_overwriting(slow: Any, hunter: Hunter, recipes: list[Path], command: Any, out: Path, hashes: Any):
    check = plant(out.parent, "outs")
    builds = [command(recipe, "--overwrite") for recipe in recipes]
    datasets = []
    for build in builds:
        longest = undisturbed(build, slow.environment)
        datasets.append(hashes(out))
    assert datasets[0] != datasets[1]
    turn = 0
    while hunter.kills.total() < 60:
        if hunter.run("overwrite", builds[turn], longest, NO_WORKERS):
            assert hashes(out) == datasets[turn]
            turn = 1 - turn
        # In the midst of a swap there is none, and the next build puts it back.
        assert not out.exists() or hashes(out) in datasets
    undisturbed(builds[turn], slow.environment)
    assert hashes(out) == datasets[turn]
    assert beside(out) == set()
    check()
    assert leftovers(slow) == []


def fill(cache: Cache, n_entries: int) -> dict[Path, int]:
    """Publish entries; returns the inode of each by path."""
    for number in range(n_entries):
        cache.put_array("features", f"{number:064x}", np.arange(number % 7), durable=False)
    return state_of(cache)


def state_of(cache: Cache) -> dict[Path, int]:
    return {entry.path: entry.path.stat().st_ino for entry in entries(cache.root)}


def damage(cache: Cache) -> set[Path]:
    """Change a bit in every tenth entry; returns which."""
    chosen = {entry.path for number, entry in enumerate(entries(cache.root)) if number % 10 == 0}
    for path in chosen:
        data = bytearray(path.read_bytes())
        data[-1] ^= 1
        path.write_bytes(data)
    return chosen


def test_pruning(slow: Any, hunter: Hunter, cache_kills: int):
    cache, n_entries = Cache(slow.cache), 1500 if cache_kills > 1 else 300
    check = plant(cache.root, "cache")
    prune_all = [*CACHE, "prune", "--max-size", "1B"]
    fill(cache, n_entries)
    longest = undisturbed(prune_all, slow.environment)
    assert not state_of(cache)
    known = fill(cache, n_entries)
    while hunter.kills.total() < cache_kills:
        ended = hunter.run("prune", prune_all, longest, NO_WORKERS)
        left = state_of(cache)
        assert left.items() <= known.items()
        assert not (ended and left)
        assert verify_cache(cache.root) == (len(left), [])
        known = fill(cache, n_entries) if ended else left
    check()
    assert leftovers(slow) == []


def test_verifying(slow: Any, hunter: Hunter, cache_kills: int):
    cache, n_entries = Cache(slow.cache), 1500 if cache_kills > 1 else 300
    check = plant(cache.root, "cache")
    verify = [*CACHE, "verify", "--remove"]
    fill(cache, n_entries)
    longest = undisturbed(verify, slow.environment)
    damaged = damage(cache)
    known = state_of(cache)
    while hunter.kills.total() < cache_kills:
        ended = hunter.run("verify", verify, longest, NO_WORKERS, codes=(0, 1))  # 1: there were damaged ones
        left = state_of(cache)
        assert left.items() <= known.items()
        assert known.keys() - left.keys() <= damaged
        assert not (ended and damaged & left.keys())
        if ended:
            fill(cache, n_entries)
            damaged = damage(cache)
        known = state_of(cache)
    check()
    assert leftovers(slow) == []

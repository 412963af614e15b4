"""Reads cases in a separate process, which a broken reader may take down; hunt.py starts and watches it.

A case may end in a valid result or in an error of the DanceDataError family that names the file, is short, and can be
printed and stored. All else is a finding: another exception, more than a second of processor time, more than 200 MB,
anything run or written.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import resource
import shutil
import signal
import sys
import time
import traceback
import typing
import unicodedata  # noqa: F401 -- Python's parser imports it for letters beyond ASCII
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from targets import DEFECT, TARGETS, Target, is_plain  # noqa: E402 -- in the folder of this script

from dancedata.core.errors import DanceDataError, RecipeError  # noqa: E402
from dancedata.core.registry import (  # noqa: E402
    ANNOTATORS,
    REGISTRIES,  # noqa: E402
    RULES,
    TRANSFORMS,
)

LIMIT_S = 1.0
LIMIT_BYTES = 200 << 20
#: Characters of an error; one about a recipe lists all that is wrong with it.
MAX_MESSAGE = 2500
#: Exit status of a child in which foreign code was about to run.
TRIPPED = 97
_FORBIDDEN = [
    "os.system",
    "os.exec",
    "os.fork",
    "os.forkpty",
    "os.posix_spawn",
    "os.spawn",
    "os.startfile",
    "os.remove",
    "os.rename",
    "os.rmdir",
    "os.link",
    "os.symlink",
    "os.chmod",
    "os.chown",
    "os.putenv",
    "subprocess.Popen",
    "exec",
    "code.__new__",
    "marshal.load",
    "marshal.loads",
    "pickle.find_class",
    "socket.connect",
    "socket.bind",
    "ctypes.dlopen",
    "ctypes.dlsym",
    "shutil.rmtree",
    "tempfile.mkstemp",
    "import",
]


def serve() -> None:
    """Fork a process for each line of input: its arguments, its longest time in seconds, files for its output.

    Imports take longer than most cases. Prints the exit status of each process.
    """
    import hypothesis  # noqa: F401
    import joblib  # noqa: F401
    import scipy.spatial.transform  # noqa: F401
    import soundfile  # noqa: F401
    import soxr  # noqa: F401
    import structures  # noqa: F401

    import dancedata.datasets.folder.reader
    import dancedata.recipes.parse
    import dancedata.testing.stores  # noqa: F401

    for registry in (*REGISTRIES.values(), TRANSFORMS, ANNOTATORS, RULES):
        registry.names()
    gc.freeze()
    for line in sys.stdin:
        words, longest_s, *files = json.loads(line)
        forked = os.fork()
        if not forked:
            for number, path in enumerate(files, start=1):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
            signal.alarm(longest_s)
            main(words)
            # An interpreter that ends touches all its memory, which would be copied then.
            sys.stdout.flush()
            os._exit(0)
        print(os.waitstatus_to_exitcode(os.waitpid(forked, 0)[1]), flush=True)


def main(words: list[str]) -> None:
    """Read cases `first` to `first + count` of a target, or given files, and print the outcomes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("target", choices=[*TARGETS, "defect"])
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=0)
    parser.add_argument("--structured", action="store_true", help="cases that hypothesis makes")
    parser.add_argument("--files", type=Path, nargs="*", default=())
    given = parser.parse_args(words)
    target = TARGETS.get(given.target, DEFECT)
    seeds = target.seeds()
    runner = Runner(target, given.scratch)
    for seed in [*seeds, *seeds]:
        runner.read(seed)
        if runner.outcome.startswith("FINDING") or (seed == seeds[0] and runner.outcome != "valid"):
            sys.exit(f"a valid file for {given.target} is not read: {runner.outcome} {runner.found}")
    for registry in (*REGISTRIES.values(), TRANSFORMS, ANNOTATORS, RULES):
        registry.names()  # a recipe imports the plug-ins that it names
    if given.structured:
        # Imports all that hypothesis needs before the limits hold.
        _structured(given.target, runner, given.seed, 2)
    runner.begin()
    if given.structured:
        _structured(given.target, runner, given.seed + given.first, given.count)
    elif given.files:
        for path in given.files:
            runner.run(path.read_bytes())
    else:
        for k in range(given.first, given.first + given.count):
            runner.run(target.mutated(seeds, Random(f"{given.target} {given.seed} {k}")))
    print(json.dumps(runner.report()))


def _structured(name: str, runner: Runner, seed: int, count: int) -> None:
    import hypothesis
    import structures

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(structures.STRATEGIES[name])
    def case(data: bytes) -> None:
        runner.run(data)

    case()


class Runner:
    """Reads cases one after another and keeps count."""

    def __init__(self, target: Target, scratch: Path) -> None:
        self.target = target
        self.folder = scratch / "case"
        self.findings = scratch / "findings"
        self.findings.mkdir(parents=True, exist_ok=True)
        self.progress = scratch / "progress"
        self.outcome = ""
        self.outcomes: Counter[str] = Counter()
        self.limited = False
        self.slowest_s = 0.0
        self.growth_bytes = 0
        self.cases = 0
        self.found: list[dict[str, str]] = []
        warnings.simplefilter("error")

    def begin(self) -> None:
        """From here on the limits hold."""
        self.cases, self.outcomes, self.growth_bytes = 0, Counter(), 0
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        self.limited = True
        sys.addaudithook(self._audit)

    def run(self, data: bytes) -> None:
        """Read one case."""
        # What is known if this case is the last.
        self.progress.write_text(json.dumps(self.report()))
        before = time.process_time()
        if self.limited:
            # Processor time, because machines may be busy; the system ends the process at any point.
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
        self.read(data)
        signal.setitimer(signal.ITIMER_PROF, 0)
        self.slowest_s = max(self.slowest_s, time.process_time() - before)
        self.cases += 1
        self.outcomes[self.outcome] += 1

    def read(self, data: bytes) -> None:
        """Write the case and read it; `outcome` is the result."""
        self.watching = False
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        path = self.folder / self.target.file
        path.write_bytes(data)
        held, resident = _memory()
        self.watching = True
        # The limit is the reader's: what makes the cases, an LZMA compressor say, may need more.
        if self.limited:
            resource.setrlimit(resource.RLIMIT_AS, (held + LIMIT_BYTES, resource.RLIM_INFINITY))
        try:
            self.target.read(path)
            self.outcome = "valid"
        except DanceDataError as error:
            self.watching = False
            self.outcome = error.reason or type(error).__name__
            if any(isinstance(e, MemoryError) and not _parser_gave_up(e) for e in _chain(error)):
                self._finding("memory", data, error)
            elif not any(name in str(error) for name in (path.name, str(self.folder), *self.target.also)):
                self._finding("the error does not name the file", data, error)
            elif len(str(error)) > MAX_MESSAGE * (10 if isinstance(error, RecipeError) else 1):
                self._finding("the message is not cut", data, error)
            elif not is_plain(str(error)):
                self._finding("the message does not print", data, error)
        except BaseException as error:  # noqa: BLE001 -- every exception is a finding
            self.watching = False
            self._finding(type(error).__name__, data, error)
        finally:
            self.watching = False
            resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            self.growth_bytes = max(self.growth_bytes, _peak() - resident)

    def report(self) -> dict[str, Any]:
        """Return what is to be known of all cases."""
        return {
            "cases": self.cases,
            "outcomes": dict(self.outcomes),
            "slowest_s": round(self.slowest_s, 3),
            "peak_growth_mb": round(self.growth_bytes / 2**20, 1),
            "findings": self.found,
        }

    def _finding(self, what: str, data: bytes, error: BaseException) -> None:
        self.outcome = f"FINDING {what}"
        frames = traceback.extract_tb(error.__traceback__)
        at = next((f for f in reversed(frames) if "dancedata" in f.filename and "fuzz" not in f.filename), frames[-1])
        place = f"{Path(at.filename).name}:{at.lineno}"
        file = self.findings / f"{len(list(self.findings.iterdir())):04d}-{self.target.file}"
        file.write_bytes(data)
        self.found.append({"what": what, "where": place, "error": str(error)[:300], "file": str(file)})

    def _audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.watching:
            return
        wrong = event in _FORBIDDEN and not _is_own(event, arguments)
        if event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
            wrong = not str(arguments[0]).startswith(str(self.folder))
        if wrong:
            self.watching = False
            stack = "".join(traceback.format_stack()[-6:-1])
            os.write(2, f"tripwire: {event} {arguments!r}"[:300].encode() + b"\n" + stack.encode())
            os._exit(TRIPPED)


def _memory() -> tuple[int, int]:
    """Return the address space of this process and what of it is in memory, bytes; the peak is counted from here."""
    Path("/proc/self/clear_refs").write_text("5")
    held, resident = Path("/proc/self/statm").read_text().split()[:2]
    return int(held) * resource.getpagesize(), int(resident) * resource.getpagesize()


def _peak() -> int:
    """Return the most that was in memory since `_memory`, bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def _is_own(event: str, arguments: tuple[Any, ...]) -> bool:
    """Tell whether it is Python's own doing: codecs that are imported, annotations of classes that are evaluated."""
    if event in ("exec", "marshal.loads"):
        files = {frame.f_code.co_filename for frame, _ in traceback.walk_stack(None)}
        # Imports were recorded at the start.
        return bool(files & {typing.__file__, "<frozen importlib._bootstrap>"})
    return event == "import" and str(arguments[0]).startswith("encodings")


def _parser_gave_up(error: BaseException) -> bool:
    """Tell whether Python's parser said MemoryError, as it does of text that is nested too deep."""
    frames = traceback.extract_tb(error.__traceback__)
    return bool(frames) and Path(frames[-1].filename).name == "ast.py"


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    seen: list[BaseException] = []  # an error that is raised again can be its own context
    while error is not None and error not in seen:
        yield error
        seen.append(error)
        error = error.__cause__ or error.__context__


if __name__ == "__main__":
    serve()

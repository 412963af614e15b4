"""Worker processes that die under loky: the build continues, or names the unit at fault. Clusters: test_clusters."""

import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from dancedata.building.build import build
from dancedata.cli.app import app
from dancedata.clusters import dask
from dancedata.core.errors import DanceDataError
from dancedata.execution import arithmetic, requirements
from dancedata.execution.executors import Executor
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units
from dancedata.files.cache_files import locked_file
from dancedata.recipes.parse import load_recipe
from tests import warm


def test_a_worker_killed_under_loky_loses_only_its_unit(slow, corpus, out, songs, undisturbed, hashes):
    for song in songs[1:3]:
        (slow.folder / f"kill-once-{song}").touch()
    slow.build(corpus, out, "--jobs", 2)
    assert hashes(out) == undisturbed
    assert set(songs[1:3]) <= {song for song in songs if slow.calls().count(song) > 1}
    assert len(slow.calls()) <= 10
    # loky ends all workers when one dies: what the others held may be left, until the next build.
    shutil.rmtree(out)
    slow.build(corpus, out, "--jobs", 1)
    assert slow.strays() == []


def test_what_a_killed_worker_was_writing_is_swept_by_the_next_build(slow, corpus, out, songs, undisturbed, hashes):
    (slow.folder / f"kill-writing-{songs[1]}").touch()
    slow.build(corpus, out, "--jobs", 2)
    assert hashes(out) == undisturbed
    assert ".tmp" in {Path(path).suffix for path in slow.strays()}
    shutil.rmtree(out)
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert slow.strays() == []


@pytest.mark.parametrize(
    ("wrong", "output"),
    [
        ({}, None),
        ({"token_text": "another"}, "a worker sees a different cache"),
        ({"token": Path("/proc/none")}, "a worker does not see the cache"),
        ({"source": Path("/proc/none")}, "a worker does not see the source"),
        ({"names_sha256": "another"}, "a worker sees a different source"),
        ({"versions": (("numpy", "0.1"),)}, r"versions differ.*numpy [0-9.]*, not 0\.1"),
        ({"locked": False}, "locks on files in the cache do not reach"),
    ],
)
def test_a_worker_is_checked_for_its_requirements(corpus, tmp_path, wrong, output):
    with ExitStack() as stack:
        token = tmp_path / "w.token"
        if wrong.pop("locked", True):
            stack.enter_context(locked_file(tmp_path, token.name))
        token.write_text("w")
        right: dict[str, Any] = {"token": token, "token_text": "w", "source": corpus}
        right |= {
            "names_sha256": requirements.names_sha256(corpus),
            "versions": requirements.versions_of({"librosa"}, arithmetic.here()),
        }
        check = partial(requirements.check_worker, requirements.Requirements(**{**right, **wrong}))
        is_error, result = pickle.loads(Executor.run_packed(check, pickle.dumps((abs, (-3,)))))
    assert is_error == (output is not None), result
    if output is None:
        assert result == 3
    else:
        assert isinstance(result, DanceDataError)
        assert re.search(output, str(result))


BEGUN, GO_ON = threading.Event(), threading.Event()


def wait() -> int:
    BEGUN.set()
    GO_ON.wait(60)
    return 1


def test_a_worker_with_threads_is_refused() -> None:
    """They would undo each other's limit on BLAS."""
    with ThreadPoolExecutor(1) as other:
        first = other.submit(Executor.run_packed, None, pickle.dumps((wait, ())))
        BEGUN.wait(60)
        is_error, refused = pickle.loads(Executor.run_packed(None, pickle.dumps((abs, (-3,)))))
        GO_ON.set()
        assert pickle.loads(first.result()) == (False, 1)
    assert is_error
    assert "--nthreads 1" in str(refused)


@pytest.mark.parametrize(
    ("options", "output"),
    [
        (["--cluster", "ray://:10001"], "not a complete one; found ray://:10001; allowed: ray://HOST:10001"),
        (["--cluster", "spark://HOST:7077"], "not a complete one; found spark://HOST:7077; allowed: tcp://"),
        (["--part", "5/4"], "a part is NUMBER/COUNT"),
        (["--part", "1/4", "--cluster", "ray://auto"], "--part cannot be combined"),
    ],
)
def test_wrong_options(corpus: Path, out: Path, options: list[str], output: str):
    arguments = ["build", "aist++", str(corpus), "--out", str(out), *options]
    result = CliRunner().invoke(app, arguments)
    assert (result.exit_code, output in result.stderr) == (2, True), result.stderr
    assert not out.exists()


def test_a_scheduler_that_does_not_answer(corpus: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(dask, "TIMEOUT_S", 0.5)
    options = {"cache": tmp_path / "cache", "backend": "dask", "scheduler": "tcp://127.0.0.1:9"}
    with pytest.raises(DanceDataError, match="no Dask scheduler answers"):
        build(load_recipe("aist++"), corpus, out, **options)
    assert not out.exists()


CRASH = """
import signal, sys
from dancedata.__main__ import main
from dancedata.building import plan
plan.make_plan = lambda *args, **options: signal.raise_signal(signal.SIGSEGV)
sys.argv = ["dancedata", "build", "demo", "--dry-run"]
main()
"""


def test_a_crash_in_the_only_process_shows_where_it_was() -> None:
    """As of a decoder that crashes with --jobs 1, where no worker shields the command."""
    done = subprocess.run([sys.executable, "-c", CRASH], capture_output=True, text=True, timeout=60)
    assert done.returncode == -signal.SIGSEGV
    assert "Segmentation fault" in done.stderr


class DiesOnArrival:
    """A function whose modules crash when a worker imports them."""

    def __reduce__(self) -> Any:
        return os._exit, (7,)

    def __call__(self, path: Path) -> None: ...


def test_no_unit_is_blamed_for_workers_that_die_before_they_run_one() -> None:
    calls = [(Path("a.wav"),), (Path("b.wav"),)]
    with pytest.raises(DanceDataError, match="worker processes die during decoding before they run a unit") as caught:
        run_units(DiesOnArrival(), calls, jobs=2, label="decoding", progress=Progress(quiet=True))
    assert "a.wav" not in str(caught.value)


def test_only_running_units_are_suspected_when_a_worker_dies() -> None:
    found: dict[int, Any] = {}
    calls = {number: (number,) for number in (2, 3, 5, 7, 11, 13)}
    suspects = Executor(2).run(exit_at_5, calls, "x", found.__setitem__)
    assert 5 in suspects
    assert len(suspects) <= 2
    assert not set(found) & set(suspects)


def test_a_failure_drops_the_other_calls_in_silence() -> None:
    """Whatever a thread of loky says of it is an error here, see `filterwarnings`."""
    for _ in range(3):
        with pytest.raises(ZeroDivisionError):
            Executor(2).run(divmod, {number: (number, number) for number in range(2_000)}, "x", lambda *_: None)


def exit_at_5(number: int) -> int:
    if number == 5:
        os._exit(1)
    return number


def test_a_replaced_worker_ends_no_stage_where_warnings_are_errors() -> None:
    """loky warns of it in the thread that collects results: an error there would leave the stage waiting for ever."""
    loky = "A worker stopped while some jobs were given to the executor."
    for _ in range(2):  # the second finds the pool of the first, and filters that were reset since
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            Executor(2).run(abs, {1: (-1,), 2: (-2,)}, "x", lambda number, result: warnings.warn(loky, stacklevel=1))


RUN = """
import multiprocessing, pathlib, signal, sys, time
from joblib.externals import loky
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units

OPTIONS = {"jobs": 2, "label": "odd", "progress": Progress(quiet=True), "exact": False}
"""


def script(code: str, *args: Any) -> subprocess.CompletedProcess[str]:
    return warm.run([sys.executable, "-c", code, *map(str, args)])


INTERRUPTED = """
def unit(folder, number):
    time.sleep(0.1)
    pathlib.Path(folder, str(number)).touch()

class Interrupted(loky.ProcessPoolExecutor):
    def submit(self, *args):
        future = super().submit(*args)
        signal.raise_signal(signal.SIGINT)
        return future

loky.ProcessPoolExecutor = Interrupted
try:
    run_units(unit, [(sys.argv[1], n) for n in range(200)], **OPTIONS)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_an_interrupt_while_workers_start_ends_them(tmp_path: Path) -> None:
    """Otherwise the interpreter would wait at its end until all units are computed."""
    done = script(RUN + INTERRUPTED, tmp_path)
    assert done.stdout == "interrupted\n", done.stderr
    assert len(list(tmp_path.iterdir())) < 200


DAEMON = """
def daemon(answer):
    answer.put(run_units(abs, [(-1,), (-2,)], **OPTIONS))

context = multiprocessing.get_context("fork")
answer = context.Queue()
process = context.Process(target=daemon, args=(answer,), daemon=True)
process.start()
print(answer.get(timeout=60))
process.join()
"""


def test_a_daemonic_process_computes_by_itself() -> None:
    """As a worker of multiprocessing.Pool, which may not start processes."""
    done = script(RUN + DAEMON)
    assert done.stdout == "[1, 2]\n", done.stderr


def test_workers_keep_the_users_settings_of_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "1000000")
    monkeypatch.delenv("MALLOC_MMAP_THRESHOLD_", raising=False)
    names = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")
    code = f"import os\ndef kept(name): return os.environ.get(name)\n{RUN}\n"
    done = script(f"{code}print(*run_units(kept, [(name,) for name in {names}], **OPTIONS))")
    assert done.stdout == "1000000 None\n", done.stderr


def test_relative_paths_name_the_same_files_in_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers that run already were started in another folder, which may have a file of the same name."""
    quiet = Progress(quiet=True)
    read = [(Path("sample.txt"),)] * 2
    for name in ("first", "second", "first"):
        (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / name / "sample.txt").write_text(name, encoding="utf-8")
        monkeypatch.chdir(tmp_path / name)
        assert run_units(Path.read_text, read, jobs=2, label="reading", progress=quiet) == [name] * 2

"""Ray clusters and backends of joblib: equal bytes, equal rejects, the unit named that kills its workers."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from dancedata.cli import interrupts
from tests.clusters import SPARK, processes_of, ray_client_server, ray_cluster, ray_settings

HAS_RAY = pytest.mark.skipif(not find_spec("ray"), reason="the extra ray is not installed")
HAS_SPARK = pytest.mark.skipif(
    not (find_spec("joblibspark") and find_spec("pyspark")), reason="the extra spark is not installed"
)


@pytest.fixture
def ray_two(slow: Any) -> Iterator[None]:
    """Run two workers."""
    with ray_cluster(slow.environment):
        yield


@HAS_RAY
@pytest.mark.usefixtures("ray_two")
def test_ray_gives_the_same_bytes_and_survives_a_killed_worker(
    slow: Any, corpus: Path, out: Path, songs: list[str], undisturbed: dict[str, str], hashes: Any
):
    slow.sleep(0.3)
    (slow.folder / f"kill-once-{songs[0]}").touch()
    printed = slow.build(corpus, out, "--scheduler", "ray://auto")
    assert hashes(out) == undisturbed
    assert sorted(slow.calls()) == sorted([*songs, songs[0]]), "only the unit of the dead worker ran again"
    assert slow.strays() == []
    assert "raylet" not in printed


@pytest.mark.parametrize("backend", ["loky", "threading"])
def test_joblib_gives_the_same_bytes_and_rejects(
    slow: Any, corpus: Path, out: Path, tmp_path: Path, songs: list[str], hashes: Any, backend: str
):
    source = shutil.copytree(corpus, tmp_path / "source")
    broken = sorted((source / "motions").glob("*.pkl"))[0]
    broken.write_bytes(broken.read_bytes()[:1000])
    if backend == "loky":
        (slow.folder / f"kill-once-{songs[1]}").touch()
    slow.build(source, out, "--scheduler", f"joblib:{backend}")
    assert slow.calls().count(songs[1]) == (2 if backend == "loky" else 1)
    slow.build(source, tmp_path / "here", "--jobs", 1)
    assert hashes(out) == hashes(tmp_path / "here")
    assert broken.name in (out / "rejects.jsonl").read_text()
    assert slow.strays() == []


def test_a_unit_that_always_kills_its_worker_of_joblib_is_named(slow: Any, corpus: Path, out: Path, songs: list[str]):
    (slow.folder / f"kill-{songs[2]}").touch()
    output = slow.build(corpus, out, "--scheduler", "joblib:loky", code=1)
    assert "this unit of work kills its worker process (slow)" in output
    assert str(sorted((corpus / "wavs").glob("*.wav"))[2]) in output
    assert not out.exists()


@contextmanager
def requirements_of(folder: Path) -> Iterator[Any]:
    """Give the requirements of a build with an empty source."""
    from dancedata.execution.cache import Cache
    from dancedata.execution.executors.remote import worker_requirements

    (folder / "source").mkdir()
    with worker_requirements(Cache(folder / "cache"), folder / "source", set()) as requirements:
        yield requirements


class Raises:
    """A unit that raises an error."""

    def __init__(self, kind: type[Exception], *args: Any) -> None:
        self.kind, self.args = kind, args

    def __call__(self) -> None:
        raise self.kind(*self.args)


class TwoArgumentsError(Exception):
    """Does not unpickle."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} {second}")

    def __reduce__(self) -> Any:  # explicit: distributed, once loaded, changes how errors are pickled
        return TwoArgumentsError, ("one",)


def test_answers_of_workers(tmp_path: Path) -> None:
    """Where a worker had loaded numpy before, units run in a second process: one that kills it is a suspect."""
    from dancedata.core.errors import DanceDataError
    from dancedata.execution.executors.base import WorkerDiedError
    from dancedata.execution.executors.remote import Answers, packed, run_packed
    from dancedata.execution.reference_process import ReferenceProcessError

    found: dict[int, Any] = {}
    answers = Answers("x", found.__setitem__)
    with requirements_of(tmp_path) as requirements:

        def run(index: int, function: Any, *call: Any) -> None:
            answers.take(index, run_packed("Ray", requirements, packed("x", function, call)))

        run(0, abs, -2)
        run(1, Raises(ReferenceProcessError, "the process that computes features died"))
        run(2, abs, -3)
        with pytest.raises(ZeroDivisionError):
            run(3, divmod, 1, 0)
        with pytest.raises(DanceDataError, match=r"cannot be sent between processes during x.*argument"):
            run(4, Raises(TwoArgumentsError, "a", "b"))
        with pytest.raises(DanceDataError, match=r"cannot be sent between processes during x.*argument"):
            run(5, print, TwoArgumentsError("a", "b"))
    with pytest.raises(WorkerDiedError, match="the process that computes") as caught:
        answers.end()
    assert caught.value.suspects == [1]
    assert found == {0: 2, 2: 3}


def test_a_worker_of_joblib_with_threads_is_refused(tmp_path: Path) -> None:
    from dancedata.core.errors import DanceDataError
    from dancedata.execution.executors import joblib
    from dancedata.execution.executors.remote import Answers, packed

    found: dict[int, Any] = {}
    with requirements_of(tmp_path) as requirements:
        here, message = joblib._process(), packed("x", abs, (-2,))
        with joblib._running:  # another unit
            Answers("x", found.__setitem__).take(*joblib._run(here, requirements, 0, message))
            with pytest.raises(DanceDataError, match="runs several units at once in threads"):
                Answers("x", print).take(*joblib._run("elsewhere:1", requirements, 1, message))
        Answers("x", found.__setitem__).take(*joblib._run("elsewhere:1", requirements, 2, message))
    assert found == {0: 2, 2: 2}


def test_a_backend_that_the_user_registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import joblib
    from joblib.parallel import ThreadingBackend

    from dancedata.execution.cache import Cache
    from dancedata.execution.progress import Progress
    from dancedata.execution.units import run_units, start_workers

    used: list[int] = []

    class Counting(ThreadingBackend):
        def submit(self, func: Any, callback: Any = None) -> Any:
            used.append(1)
            return super().submit(func, callback)

    monkeypatch.setattr(joblib.parallel, "BACKENDS", dict(joblib.parallel.BACKENDS))  # as it was, at the end
    joblib.register_parallel_backend("counting", Counting)
    (tmp_path / "source").mkdir()
    cache = Cache(tmp_path / "cache")
    with start_workers(1, cache, tmp_path / "source", set(), scheduler="joblib:counting") as workers:
        calls = [(-n,) for n in range(7)]
        assert run_units(abs, calls, jobs=workers, label="x", progress=Progress(quiet=True)) == list(range(7))
    assert len(used) == 7


# Each of these takes half a minute to some minutes: python -m pytest -m nightly tests/fault/test_clusters.py


@pytest.fixture(params=[pytest.param("ray", marks=HAS_RAY), pytest.param("spark", marks=HAS_SPARK), "joblib:loky"])
def cluster(request: pytest.FixtureRequest, slow: Any) -> Iterator[list[str]]:
    """Two workers of each engine; gives the options of `build` that use it."""
    if request.param == "ray":
        with ray_cluster(slow.environment):
            yield ["--scheduler", "ray://auto"]
    elif request.param == "spark":
        slow.environment |= SPARK
        yield ["--scheduler", "joblib:spark"]
    else:
        yield ["--scheduler", "joblib:loky"]


@pytest.mark.nightly
def test_a_killed_worker_changes_nothing(
    slow: Any, corpus: Path, out: Path, songs: list[str], cluster: list[str], undisturbed: dict[str, str], hashes: Any
):
    for song in songs[1:3]:
        (slow.folder / f"kill-once-{song}").touch()
    slow.build(corpus, out, *cluster)
    assert hashes(out) == undisturbed
    assert {song for song in songs if slow.calls().count(song) > 1} >= set(songs[1:3])
    assert slow.strays() == []


@pytest.mark.nightly
def test_a_unit_that_always_kills_its_worker_is_named(
    slow: Any, corpus: Path, out: Path, songs: list[str], cluster: list[str], undisturbed: dict[str, str], hashes: Any
):
    order = slow.folder / f"kill-{songs[2]}"
    order.touch()
    output = slow.build(corpus, out, *cluster, code=1)
    assert "this unit of work kills its worker process (slow)" in output
    assert str(sorted((corpus / "wavs").glob("*.wav"))[2]) in output
    assert not out.exists()
    order.unlink()
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert slow.strays() == []


@pytest.mark.nightly
def test_ctrl_c_cancels(
    slow: Any, corpus: Path, out: Path, cluster: list[str], undisturbed: dict[str, str], hashes: Any
):
    slow.sleep(5)
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = slow.start_cold(corpus, out, *cluster, start_new_session=True, **pipes)
    while not slow.calls() and process.poll() is None:
        time.sleep(0.1)
    begun = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    printed, errors = process.communicate(timeout=60)
    assert (process.returncode, printed) == (130, "")
    assert errors.endswith(f"{interrupts.LINE}\n"), errors
    assert "Traceback" not in errors
    print(f"{cluster}: ended after {time.monotonic() - begun:.1f} s")
    calls = slow.calls()
    time.sleep(2)
    assert slow.calls() == calls, "nothing is computed any more"
    assert not out.exists()
    slow.sleep(0)
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert slow.strays() == []


@HAS_RAY
@pytest.mark.nightly
def test_a_build_resumes_after_a_lost_ray_cluster(
    slow: Any, corpus: Path, out: Path, undisturbed: dict[str, str], hashes: Any
):
    slow.sleep(30)
    with ray_cluster(slow.environment) as cluster:
        building = slow.start(corpus, out, "--scheduler", "ray://auto")
        while not slow.calls():
            time.sleep(0.1)
        os.killpg(cluster.pid, signal.SIGKILL)
        for process in processes_of(cluster.pid):
            os.kill(process, signal.SIGKILL)
        begun = time.monotonic()
        _, output = building.communicate(timeout=120)
        print(f"reported after {time.monotonic() - begun:.1f} s")
    assert building.returncode == 1, output
    assert "the Ray cluster was lost" in output
    assert "Traceback" not in output
    assert not out.exists()
    slow.sleep(0)
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed


@HAS_RAY
@pytest.mark.nightly
@pytest.mark.parametrize("deaths", [0, 1])
def test_ray_client_gives_the_same_bytes(
    slow: Any, corpus: Path, out: Path, undisturbed: dict[str, str], hashes: Any, deaths: int
):
    with ray_cluster(slow.environment), ray_client_server(slow.environment, deaths) as port:
        slow.build(corpus, out, "--scheduler", f"ray://127.0.0.1:{port}")
    assert hashes(out) == undisturbed


@HAS_RAY
@pytest.mark.nightly
def test_ray_client_whose_processes_die(slow: Any, corpus: Path, out: Path):
    with ray_cluster(slow.environment), ray_client_server(slow.environment, deaths=99) as port:
        output = slow.build(corpus, out, "--scheduler", f"ray://127.0.0.1:{port}", code=1)
    assert "found Initialization failure from server: RuntimeError: Starting Ray client server failed" in output
    assert "GRPC_ENABLE_FORK_SUPPORT=0" in output
    assert not out.exists()


@HAS_RAY
@pytest.mark.nightly
def test_a_ray_worker_with_another_version_is_refused(slow: Any, corpus: Path, out: Path, tmp_path: Path):
    info = tmp_path / "other" / "numpy-0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: numpy\nVersion: 0.1\n")
    right = slow.environment["PYTHONPATH"]
    slow.environment["PYTHONPATH"] = os.pathsep.join([str(info.parent), right])
    with ray_cluster(slow.environment):
        slow.environment["PYTHONPATH"] = right
        output = slow.build(corpus, out, "--scheduler", "ray://auto", code=1)
    assert "package versions differ on a worker" in output
    assert re.search(r"found numpy 0\.1, not [0-9.]+\. Use on all workers", output)
    assert not out.exists()


@HAS_RAY
@pytest.mark.nightly
def test_ray_kills_workers_for_their_memory(slow: Any, corpus: Path, out: Path):
    slow.environment |= {"RAY_memory_usage_threshold": "0.01", "RAY_memory_monitor_refresh_ms": "100"}
    with ray_cluster(slow.environment):
        output = slow.build(corpus, out, "--scheduler", "ray://auto", code=1)
    assert "running low on memory" in output
    assert not out.exists()


LOST_MACHINE = """
import sys, threading, time
from pathlib import Path
import ray
from ray.cluster_utils import Cluster
from dancedata.execution.cache import Cache
from dancedata.execution.units import start_workers

def unit(number, folder):
    node = ray.get_runtime_context().get_node_id()
    Path(folder, f"{number} {node}").touch()
    time.sleep(6)
    return number

if __name__ == "__main__":
    folder = sys.argv[1]
    machines = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    second = machines.add_node(num_cpus=1)
    ray.init(address=machines.address, log_to_driver=False)
    Path(folder, "log").mkdir()

    def lose():
        while not any(second.node_id in path.name for path in Path(folder, "log").iterdir()):
            time.sleep(0.1)
        machines.remove_node(second, allow_graceful=False)

    threading.Thread(target=lose).start()
    found = {}
    with start_workers(1, Cache(Path(folder)), Path(folder), set(), scheduler="ray://auto") as workers:
        workers.run(unit, {n: (n, f"{folder}/log") for n in range(4)}, "x", found.__setitem__)
    print(sorted(found.items()) == [(n, n) for n in range(4)], len(list(Path(folder, "log").iterdir())))
    ray.shutdown()
    machines.shutdown()
"""


@HAS_RAY
@pytest.mark.nightly
def test_units_of_a_lost_machine_run_elsewhere(slow: Any, tmp_path: Path):
    """They are no suspects: `run` returns."""
    (tmp_path / "shared").mkdir()
    script = tmp_path / "lost.py"
    script.write_text(LOST_MACHINE)
    with ray_settings() as settings:
        command = [sys.executable, str(script), str(tmp_path / "shared")]
        environment = slow.environment | settings
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240)
    assert done.stdout.endswith("True 5\n"), done.stdout + done.stderr

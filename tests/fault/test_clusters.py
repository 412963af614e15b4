"""Clusters: equal bytes, equal rejects, the unit named that kills its workers."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from dancedata.cli import interrupts
from dancedata.core.errors import DanceDataError
from dancedata.execution.executors import Executor
from tests.clusters import dask_cluster, ray_client_server, ray_cluster

HAS_RAY = pytest.mark.skipif(not find_spec("ray"), reason="the extra ray is not installed")
HAS_DASK = pytest.mark.skipif(not find_spec("distributed"), reason="the extra dask is not installed")
ENGINES = [pytest.param("ray", marks=HAS_RAY), pytest.param("dask", marks=HAS_DASK)]
SLOW_ENGINES = [pytest.param(*engine.values, marks=[*engine.marks, pytest.mark.nightly]) for engine in ENGINES]


@pytest.fixture(params=ENGINES)
def cluster(request: pytest.FixtureRequest, slow: Any) -> Iterator[list[str]]:
    """Two workers of each engine; gives the options of `build` that use it."""
    if request.param == "loky":
        yield ["--jobs", "2"]
    elif request.param == "ray":
        with ray_cluster(slow.environment):
            yield ["--cluster", "ray://auto"]
    else:
        with dask_cluster(slow.environment) as address:
            yield ["--cluster", address]


def test_the_same_bytes_and_a_killed_worker_is_survived(slow, corpus, out, songs, cluster, undisturbed, hashes):
    slow.sleep(0.3)
    (slow.folder / f"kill-once-{songs[0]}").touch()
    printed = slow.build(corpus, out, *cluster)
    assert hashes(out) == undisturbed
    assert sorted(slow.calls()) == sorted([*songs, songs[0]]), "only the unit of the dead worker ran again"
    assert slow.strays() == []
    assert "raylet" not in printed


@pytest.mark.parametrize("cluster", ["loky", *SLOW_ENGINES], indirect=True)
def test_a_unit_that_always_kills_its_worker_is_named(slow, corpus, out, songs, cluster, undisturbed, hashes):
    order = slow.folder / f"kill-{songs[2]}"
    order.touch()
    output = slow.build(corpus, out, *cluster, code=1)
    assert "this unit of work kills its worker process (computing)" in output
    assert str(sorted((corpus / "wavs").glob("*.wav"))[2]) in output
    assert not out.exists()
    order.unlink()
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert slow.strays() == []


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


class InThreads(ThreadPoolExecutor):
    """A cluster in this process: one worker."""

    def __init__(self) -> None:
        super().__init__(1)

    @contextmanager
    def starting(self, label: str) -> Iterator[Any]:
        yield self.submit


def test_answers_of_workers() -> None:
    found: dict[int, Any] = {}
    with InThreads() as worker:
        executor = Executor(starting=worker.starting)

        def run(index: int, function: Any, *call: Any) -> list[int]:
            return list(executor.run(function, {index: call}, "x", found.__setitem__))

        assert run(0, abs, -2) == []
        with pytest.raises(ZeroDivisionError):
            run(3, divmod, 1, 0)
        with pytest.raises(DanceDataError, match=r"cannot be sent between processes.*argument"):
            run(4, Raises(TwoArgumentsError, "a", "b"))
        with pytest.raises(DanceDataError, match=r"cannot be sent between processes.*argument"):
            run(5, print, TwoArgumentsError("a", "b"))
    assert found == {0: 2}


# Each of these takes half a minute to some minutes: python -m pytest -m nightly tests/fault/test_clusters.py


@pytest.mark.nightly
def test_ctrl_c_cancels(slow, corpus, out, cluster, undisturbed, hashes):
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
def test_ray_client_gives_the_same_bytes(slow, corpus, out, undisturbed, hashes):
    with ray_cluster(slow.environment), ray_client_server(slow.environment) as port:
        slow.build(corpus, out, "--cluster", f"ray://127.0.0.1:{port}")
    assert hashes(out) == undisturbed


@HAS_RAY
@pytest.mark.nightly
def test_ray_client_that_does_not_answer(slow: Any, corpus: Path, out: Path):
    output = slow.build(corpus, out, "--cluster", "ray://127.0.0.1:9", code=1)
    assert "no Ray cluster answers at this address" in output
    assert not out.exists()

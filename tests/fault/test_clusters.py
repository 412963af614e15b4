"""Ray clusters and backends of joblib: equal bytes, equal rejects, the unit named that kills its workers."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from dancedata.cli import interrupts
from tests.clusters import SPARK, processes_of, ray_client_server, ray_cluster

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
def test_ray_client_gives_the_same_bytes(
    slow: Any, corpus: Path, out: Path, undisturbed: dict[str, str], hashes: Any
):
    with ray_cluster(slow.environment), ray_client_server(slow.environment) as port:
        slow.build(corpus, out, "--scheduler", f"ray://127.0.0.1:{port}")
    assert hashes(out) == undisturbed

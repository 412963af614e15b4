"""Ray clusters and backends of joblib: equal bytes, equal rejects, the unit named that kills its workers."""

import subprocess
import sys
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

HAS_RAY = pytest.mark.skipif(not find_spec("ray"), reason="the extra ray is not installed")
HAS_SPARK = pytest.mark.skipif(
    not (find_spec("joblibspark") and find_spec("pyspark")), reason="the extra spark is not installed"
)

RAY = """
import sys
import ray
ray.init(num_cpus=int(sys.argv[1]), include_dashboard=False, _temp_dir=sys.argv[2], object_store_memory=10**8)
print(ray.get_runtime_context().gcs_address, flush=True)
sys.stdin.read()
"""


@contextmanager
def ray_cluster(slow: Any, workers: int = 2) -> Iterator[subprocess.Popen[str]]:
    """Run a Ray cluster of one machine; builds in the environment of `slow` find it by ray://auto."""
    # Its sockets have paths of at most 107 characters, and a token keeps others out.
    with tempfile.TemporaryDirectory(prefix="ray", dir="/tmp", ignore_cleanup_errors=True) as folder:
        token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex * 2, "RAY_USAGE_STATS_ENABLED": "0"}
        slow.environment |= token
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        command = [sys.executable, "-c", RAY, str(workers), folder]
        with subprocess.Popen(command, env=slow.environment, text=True, start_new_session=True, **pipes) as process:
            try:
                slow.environment["RAY_ADDRESS"] = process.stdout.readline().strip()
                yield process
            finally:
                process.stdin.close()
                process.wait()


@pytest.fixture
def ray_two(slow: Any) -> Iterator[None]:
    """Run two workers."""
    with ray_cluster(slow):
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

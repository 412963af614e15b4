"""Clusters on this machine: of Dask and Ray."""

import socket
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

#: Run with the numbers of workers and of threads: prints the scheduler's address, and ends with its input.
DASK = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    n, threads = int(sys.argv[1]), int(sys.argv[2])
    with LocalCluster(n_workers=n, threads_per_worker=threads, dashboard_address=None, memory_limit=0) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""
PIPES: dict[str, Any] = {
    "stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True,
}  # fmt: skip


def native(environment: MutableMapping[str, str]) -> dict[str, str]:
    """Return an environment as of another machine, whose workers would compute as their processor has it."""
    return {name: value for name, value in environment.items() if not name.startswith(("OPENBLAS_", "NPY_"))}


@contextmanager
def dask_cluster(environment: MutableMapping[str, str], workers: int = 2, threads: int = 1) -> Iterator[str]:
    """Run a Dask cluster of processes; gives the scheduler's address."""
    command = [sys.executable, "-c", DASK, str(workers), str(threads)]
    with subprocess.Popen(command, env=native(environment), **PIPES) as process:
        try:
            yield process.stdout.readline().strip()
        finally:
            process.stdin.close()
            process.wait()


RAY = """
import sys
import ray
ray.init(num_cpus=int(sys.argv[1]), include_dashboard=False, object_store_memory=10**8)
print(ray.get_runtime_context().gcs_address, flush=True)
sys.stdin.read()
"""


@contextmanager
def ray_settings() -> Iterator[dict[str, str]]:
    """Give the environment of a Ray cluster for a test: its folder, and a token that keeps others out."""
    # Its sockets have paths of at most 107 characters.
    with tempfile.TemporaryDirectory(prefix="ray", dir="/tmp", ignore_cleanup_errors=True) as folder:
        token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex * 2}
        yield {**token, "RAY_TMPDIR": folder, "RAY_USAGE_STATS_ENABLED": "0"}


@contextmanager
def ray_cluster(environment: MutableMapping[str, str], workers: int = 2) -> Iterator[subprocess.Popen[str]]:
    """Run a Ray cluster of one machine; builds in the environment, which is changed, find it by ray://auto."""
    with ray_settings() as settings:
        environment |= settings
        command = [sys.executable, "-c", RAY, str(workers)]
        with subprocess.Popen(command, env=native(environment), start_new_session=True, **PIPES) as process:
            try:
                environment["RAY_ADDRESS"] = process.stdout.readline().strip()
                yield process
            finally:
                process.stdin.close()
                process.wait()


def processes_of(parent: int) -> list[int]:
    """Return the children of a process and theirs, those in other sessions too."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    found = [pid for pid, other in parents.items() if other == parent]
    return found + [pid for child in found for pid in processes_of(child)]


@contextmanager
def ray_client_server(environment: MutableMapping[str, str]) -> Iterator[int]:
    """Run the server of Ray Client beside a cluster, as `ray start --head` does; gives its port.

    Processes that it forks die now and then, where gRPC handles forks.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "ray.util.client.server", "--host=127.0.0.1", f"--port={port}"]
    command += [f"--address={environment['RAY_ADDRESS']}"]
    settings = {**environment, "GRPC_ENABLE_FORK_SUPPORT": "0"}
    with subprocess.Popen(command, env=settings, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            yield port
        finally:
            server.terminate()

"""The core without calls of the system, one by one and all of a system's together.

``pytest -m nightly tests/platforms`` runs everything, in minutes; ``python -m tests.platforms.suite windows`` runs
the suite's tests of files, locks, builds and faults in a mode.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dancedata.core import system
from tests.conftest import ROOT
from tests.platforms.core import run
from tests.platforms.without.sitecustomize import CALLS

#: The stand-in of Windows looks into /proc for who has a file open.
on_linux = pytest.mark.skipif(system.SYSTEM != "linux", reason="calls are taken away on Linux, which has them all")
WITHOUT = ROOT / "tests" / "platforms" / "without"


def core_without(what: str, folder: Path, jobs: int = 1) -> dict[str, Any]:
    """Run the core in a new process that lacks these calls, as its workers do; return what it printed."""
    folder.mkdir()
    environment = {
        **os.environ,
        "DANCEDATA_TEST_WITHOUT": what,
        "PYTHONPATH": os.pathsep.join([str(WITHOUT), str(ROOT)]),
        "PYTHONIOENCODING": "cp1252" if "windows" in what else "utf-8",
    }
    command = [sys.executable, "-W", "error::ResourceWarning", "-m", "tests.platforms.core", str(folder), str(jobs)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    printed: dict[str, Any] = json.loads(done.stdout)
    return printed


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Hashes of the dataset with all calls."""
    return run(tmp_path_factory.mktemp("here"), jobs=1)


@on_linux
@pytest.mark.parametrize("mode", ["macos", "windows"])
def test_the_core_gives_the_same_bytes_in_every_mode(mode: str, tmp_path: Path, here: dict[str, str]) -> None:
    # With the processor's features, which choose the kernels: other ones give other bytes, see the next test.
    assert core_without(f"{mode},-/proc", tmp_path / mode)["files"] == here


@on_linux
@pytest.mark.nightly
def test_without_the_processors_features_a_machine_has_bytes_and_keys_of_its_own(tmp_path: Path) -> None:
    found = [core_without(mode, tmp_path / str(n), jobs=2) for n, mode in enumerate(("/proc", "macos", "windows"))]
    assert found[0] == found[1] == found[2]
    assert found[0]["arithmetic"] != "x86-64-v3"


@on_linux
@pytest.mark.nightly
@pytest.mark.parametrize("call", [call for call in CALLS if call != "/proc"])
def test_the_core_without_one_call(call: str, tmp_path: Path, here: dict[str, str]) -> None:
    assert core_without(call, tmp_path / "core", jobs=2)["files"] == here


@pytest.fixture
def descriptor(tmp_path: Path) -> Iterator[int]:
    """An open file of 26 letters."""
    (tmp_path / "file").write_bytes(bytes(range(97, 123)))
    fd = system.open_file(tmp_path / "file", os.O_RDWR)
    yield fd
    os.close(fd)


@pytest.mark.parametrize("missing", [(), ("_preadv",), ("_preadv", "_pread")], ids=str)
def test_reading_by_position(descriptor: int, missing: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in missing:
        monkeypatch.setattr(system, name, None)
    os.lseek(descriptor, 3, os.SEEK_SET)
    memory = np.zeros(8, np.uint8)
    assert system.read_into(descriptor, memoryview(memory), 20) == 6
    assert memory.tobytes() == b"uvwxyz\0\0"
    assert system.read_at(descriptor, 2, 1) == b"bc"
    assert system.read_at(descriptor, 2, 26) == b""
    assert os.read(descriptor, 1) == b"d", "the descriptor's own position has moved"


@pytest.mark.parametrize("missing", [(), ("_pwrite",)], ids=str)
def test_writing_by_position(descriptor: int, missing: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in missing:
        monkeypatch.setattr(system, name, None)
    assert system.write_at(descriptor, memoryview(b"12"), 30) == 2
    assert os.read(descriptor, 40) == bytes(range(97, 123)) + b"\0\0\0\x0012"


@pytest.mark.parametrize("flags", [None, 0])
def test_mapping(descriptor: int, flags: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "_POPULATED", system._POPULATED if flags is None else flags)
    assert bytes(system.map_now(descriptor, 26, 0)) == bytes(range(97, 123))


@pytest.mark.parametrize("flag", [None, 0])
def test_a_link_is_not_followed(tmp_path: Path, flag: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "_NOFOLLOW", system._NOFOLLOW if flag is None else flag)
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="symbolic links"):
        system.open_file(tmp_path / "link", os.O_CREAT | os.O_RDWR, follow=False)
    assert not (tmp_path / "elsewhere").exists()


def test_a_system_without_locks_says_so(descriptor: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "_fcntl", None)
    monkeypatch.setattr(system, "_msvcrt", None)
    assert system.lock(descriptor) is None
    system.release(descriptor)


def test_windows_has_no_tracker_of_semaphores(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ModuleNotFoundError("No module named '_posixsubprocess'")  # as multiprocessing does there

    monkeypatch.setattr("multiprocessing.resource_tracker.ensure_running", fail)
    monkeypatch.setattr(system, "os", SimpleNamespace(name="posix"))
    with pytest.raises(ModuleNotFoundError):
        system.start_resource_tracker()
    monkeypatch.setattr(system, "os", SimpleNamespace(name="nt"))
    system.start_resource_tracker()


def test_what_is_unknown_has_a_value(monkeypatch: pytest.MonkeyPatch) -> None:
    without = SimpleNamespace(cpu_count=lambda: None, sysconf=None)
    monkeypatch.setattr(system, "os", without)
    assert (system.n_cores(), system.memory_bytes()) == (1, 0)
    monkeypatch.setattr(system, "REMOVES_OPEN", False)
    assert system.changed_ns(SimpleNamespace(st_mtime_ns=5, st_ctime_ns=7)) == 5  # type: ignore[arg-type]
    assert system.disk_bytes(SimpleNamespace(st_size=5)) == 5  # type: ignore[arg-type]

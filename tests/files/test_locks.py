"""Locks that die with their holder: one writer of a folder, and no foreign file taken for a lock."""

import errno
import multiprocessing
import os
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from dancedata.core.errors import StoreError
from dancedata.files import locks
from dancedata.files.locks import file_lock, writing_lock
from tests.commands import killed_afterwards
from tests.messages import raises_message

FORK = multiprocessing.get_context("fork") if hasattr(os, "fork") else None
HOLDER = """
import pathlib, sys, time
from dancedata.files.locks import writing_lock

with writing_lock(pathlib.Path(sys.argv[1]), "build"):
    print("ready", flush=True)
    time.sleep(600)
"""


def test_a_file_is_locked_by_one_and_gone_afterwards(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    with file_lock(path) as first, file_lock(path, wait=False) as second:
        assert (first, second, path.exists()) == (True, False, True)
    assert not path.exists()
    with file_lock(path, wait=False) as first:
        assert first


@pytest.mark.parametrize("there", [False, True])
def test_a_second_writer_fails_at_once_and_nothing_is_left(tmp_path: Path, there: bool) -> None:
    folder = tmp_path / "out"
    if there:
        folder.mkdir()
    with writing_lock(folder, "build"):
        assert [p.name for p in tmp_path.iterdir() if p != folder] == [".dancedata-out.lock"]
        with raises_message(StoreError, "writing", where="out"), writing_lock(folder, "build"):
            pass
        with writing_lock(tmp_path / "other", "build"):
            pass
    assert [p for p in tmp_path.iterdir() if p != folder] == []
    with writing_lock(folder, "build"):
        pass


def test_through_a_link_it_is_the_same_folder(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "links").mkdir()
    (tmp_path / "links" / "link").symlink_to(tmp_path / "out")
    with (
        writing_lock(tmp_path / "out", "build"),
        raises_message(StoreError, "another build is writing"),
        writing_lock(tmp_path / "links" / "link", "build"),
    ):
        pass


def test_a_lock_whose_holder_was_killed_is_free(tmp_path: Path) -> None:
    with (
        killed_afterwards(HOLDER, tmp_path / "out"),
        raises_message(StoreError, "another build is writing"),
        writing_lock(tmp_path / "out", "build"),
    ):
        pass
    assert (tmp_path / ".dancedata-out.lock").exists()
    with writing_lock(tmp_path / "out", "build"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_waiting(tmp_path: Path) -> None:
    order: list[str] = []

    def second() -> None:
        with writing_lock(tmp_path / "out", "process", wait=True):
            order.append("second")

    with writing_lock(tmp_path / "out", "process", wait=True):
        thread = threading.Thread(target=second)
        thread.start()
        time.sleep(0.1)
        order.append("first")
    thread.join()
    assert order == ["first", "second"]
    assert list(tmp_path.iterdir()) == []


def test_a_link_with_the_locks_name_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / ".dancedata-out.lock").symlink_to(tmp_path / "elsewhere")
    with (
        writing_lock(tmp_path / "out", "build"),
        raises_message(StoreError, "another build is writing"),
        writing_lock(tmp_path / "out", "build"),
    ):
        pass
    assert not (tmp_path / "elsewhere").exists()


def test_a_pipe_and_a_file_that_holds_something_stay_under_the_locks_name(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    lock = tmp_path / ".dancedata-out.lock"
    for make, is_there in (
        (os.mkfifo, Path.is_fifo),
        (lambda path: path.write_text("somebody's"), lambda path: path.read_text() == "somebody's"),
    ):
        make(lock)
        with writing_lock(tmp_path / "out", "build"):
            pass
        assert is_there(lock)
        lock.unlink()


def no_file_beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the folder above may not be written to, or OUT is a mounted volume."""
    plain = os.open

    def refuse(path: Any, flags: int, *args: Any, **options: Any) -> int:
        if str(path).endswith(".lock"):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return plain(path, flags, *args, **options)

    monkeypatch.setattr(os, "open", refuse)


def test_the_folder_is_locked_if_no_file_can_be_created_next_to_it(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    no_file_beside(monkeypatch)
    with (
        writing_lock(tmp_path / "out", "build"),
        raises_message(StoreError, "another build is writing"),
        writing_lock(tmp_path / "out", "build"),
    ):
        pass
    with pytest.raises(PermissionError), writing_lock(tmp_path / "none", "build"):
        pass


@pytest.mark.parametrize(("code", "held"), [(errno.ENOSYS, None), (errno.EBADF, False), (errno.EAGAIN, False)])
def test_lock_errors_of_file_systems(monkeypatch: pytest.MonkeyPatch, code: int, held: bool | None) -> None:
    def flock(fd: int, operation: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(locks.fcntl, "flock", flock)
    assert locks.lock_file(0) is held


def test_nfs_has_no_locks_on_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "out").mkdir()
    no_file_beside(monkeypatch)

    def flock(fd: int, operation: int) -> None:
        raise OSError(errno.EBADF, "Bad file descriptor")

    monkeypatch.setattr(locks.fcntl, "flock", flock)
    with writing_lock(tmp_path / "out", "build"), writing_lock(tmp_path / "out", "build"):
        pass


def _hold_and_fork(folder: Path, ready: Any, go_on: Any, is_done: Any) -> None:
    """Hold a lock, fork a process that lives on, and give the lock back."""
    path = folder / "unit"
    fd = locks.open_locked(path)
    assert fd is not None
    child = os.fork()
    if child == 0:
        is_done.wait(60)
        os._exit(0)
    ready.set()
    go_on.wait(60)
    path.unlink()
    locks.unlock(fd)
    os.waitpid(child, 0)


@pytest.mark.parametrize("n_waiting", [1, 2])
def test_a_process_forked_under_a_lock_does_not_keep_it(tmp_path: Path, n_waiting: int) -> None:
    """As a worker of a DataLoader that is started while a thread computes a feature."""
    assert FORK is not None
    ready, go_on, is_done = FORK.Event(), FORK.Event(), FORK.Event()
    holder = FORK.Process(target=_hold_and_fork, args=(tmp_path, ready, go_on, is_done))
    holder.start()
    assert ready.wait(60)
    found: list[int] = []
    waiting = [
        threading.Thread(target=lambda: found.append(locks.open_locked(tmp_path / "unit")), daemon=True)
        for _ in range(n_waiting)
    ]
    for thread in waiting:
        thread.start()
    time.sleep(0.2)
    go_on.set()
    for n in range(n_waiting):
        deadline = time.monotonic() + 120
        while len(found) <= n and time.monotonic() < deadline:
            time.sleep(0.01)
        if len(found) > n:
            (tmp_path / "unit").unlink()
            locks.unlock(found[n])
    n_found = len(found)
    is_done.set()
    holder.join(60)
    assert n_found == n_waiting

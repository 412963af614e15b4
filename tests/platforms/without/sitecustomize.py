"""Takes calls of the operating system away from dancedata, in every process that has this folder on PYTHONPATH.

$DANCEDATA_TEST_WITHOUT names what is missing, separated by commas: names of `CALLS`, or of `MODES`; a name after "-"
stays. dancedata's modules then get stand-ins of os, mmap, signal and fcntl without these names; other packages keep
the real ones. In a mode multiprocessing spawns processes. The stand-in of Windows also has its rules: what is open
cannot be removed, replaced or moved, nor can its folder; folders cannot be opened; `os.rename` replaces nothing; what
is open for reading only cannot be flushed; the C library translates line ends of what is not opened as binary.
"""

import errno
import importlib.abc
import importlib.machinery
import os
import sys
import time
from contextlib import suppress
from types import ModuleType

#: By name: module, and what of it is missing. Of "file" the paths that cannot be opened.
CALLS = {
    **{
        name: ("os", name)
        for name in (
            "preadv", "pread", "pwrite", "memfd_create", "sched_getaffinity", "sysconf", "register_at_fork",
            "O_NONBLOCK", "O_NOFOLLOW", "O_DIRECTORY", "O_CLOEXEC", "fork", "getuid", "geteuid", "killpg", "setsid",
            "mkfifo", "fchmod", "statvfs", "posix_fadvise", "copy_file_range", "sendfile",
        )
    },
    **{name: ("mmap", name) for name in ("MAP_POPULATE", "MAP_PRIVATE", "MAP_SHARED", "PROT_READ", "MADV_WILLNEED")},
    **{name: ("signal", name) for name in ("pthread_sigmask", "SIGXFSZ", "SIGKILL", "SIGHUP")},
    "fcntl": ("fcntl", ""),
    "resource": ("resource", ""),
    "/proc": ("file", "/proc/"),
}  # fmt: skip
#: What the systems lack. macOS has preadv since version 11, which Python of an older one does not.
MACOS = (
    "preadv", "memfd_create", "sched_getaffinity", "MAP_POPULATE", "/proc", "posix_fadvise", "copy_file_range",
)  # fmt: skip
MODES = {"macos": MACOS, "windows": tuple(CALLS)}

_asked = [name for name in os.environ.get("DANCEDATA_TEST_WITHOUT", "").split(",") if name]
MISSING = {call for name in _asked for call in MODES.get(name, (name,)) if f"-{call}" not in _asked and call in CALLS}
IS_WINDOWS = "windows" in _asked
#: Both systems start processes anew where Linux forks them, such as workers of a DataLoader.
SPAWNS = IS_WINDOWS or "macos" in _asked
#: Beyond all flags of Linux; removed before a file is opened.
O_BINARY = 1 << 40


class StandIn(ModuleType):
    """A module without some of its names; the rest is that of the real one at any time, also if a test changes it."""

    def __init__(self, real: ModuleType, **instead: object) -> None:
        super().__init__(real.__name__)
        self._hidden = {CALLS[call][1] for call in MISSING if CALLS[call][0] == real.__name__} - set(instead)
        self._real = real
        self.__dict__.update(instead)

    def __getattr__(self, name: str) -> object:
        if name in self.__dict__["_hidden"]:
            raise AttributeError(f"{self.__name__} has no {name} here")
        return getattr(self.__dict__["_real"], name)


def _stand_ins() -> dict[str, ModuleType | None]:
    import mmap
    import signal

    made: dict[str, ModuleType | None] = {name: None for name in ("fcntl", "resource") if name in MISSING}
    if IS_WINDOWS:
        made["msvcrt"] = _msvcrt()
    return {**made, "os": _os(), "mmap": StandIn(mmap), "signal": StandIn(signal)}


def _os() -> ModuleType:
    if not IS_WINDOWS:
        return StandIn(os)
    return StandIn(os, name="nt", O_BINARY=O_BINARY, open=_open, fsync=_fsync, **_rules())


def _rules() -> dict[str, object]:
    return {name: _ruled(name) for name in ("unlink", "remove", "rmdir", "rename", "replace")}


def _msvcrt() -> ModuleType:
    """Return locks of Windows, made of flock: exclusive, held by one descriptor, released when it is closed."""
    import fcntl

    module = ModuleType("msvcrt")
    module.LK_NBLCK, module.LK_UNLCK = 2, 0  # type: ignore[attr-defined]

    def locking(descriptor: int, mode: int, n_bytes: int) -> None:
        if not os.lseek(descriptor, 0, os.SEEK_CUR) >= 2**30:
            raise AssertionError("the locked byte holds data, which no other process could read then")
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB if mode else fcntl.LOCK_UN)
        except BlockingIOError as error:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES)) from error

    module.locking = locking  # type: ignore[attr-defined]
    return module


def _open(path: object, flags: int, mode: int = 0o777, **options: object) -> int:
    if os.path.isdir(path):  # type: ignore[arg-type]
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
    if not flags & O_BINARY and os.fspath(path) != os.devnull:  # type: ignore[call-overload]
        raise AssertionError(f"{path} is opened as text: line ends would be translated")
    return os.open(path, flags & ~O_BINARY, mode, **options)  # type: ignore[arg-type]


def _fsync(descriptor: int) -> None:
    import fcntl

    if fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    os.fsync(descriptor)


def _ruled(name: str) -> object:
    def call(path: object, *args: object, **options: object) -> object:
        if not _is_called_by_dancedata():
            return getattr(os, name)(path, *args, **options)
        places = [path, *args[:1]] if name in ("rename", "replace") else [path]
        if name == "rename" and os.path.lexists(args[0]):  # type: ignore[arg-type]
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), args[0])
        for place in places:
            if "dir_fd" in options and options["dir_fd"] is not None:
                place = f"/proc/self/fd/{options['dir_fd']}/{place}"
            if is_open(place):
                raise PermissionError(errno.EACCES, f"a process has it open ({os.strerror(errno.EACCES)})", place)
        return getattr(os, name)(path, *args, **options)

    return call


def _is_called_by_dancedata() -> bool:
    """Return whether dancedata removes a file, itself or through Python's library; tests tidy up as Linux does."""
    frame = sys._getframe(2)
    library = ("pathlib", "shutil", "tempfile", "weakref")
    while frame.f_back is not None and frame.f_globals.get("__name__") in library:
        frame = frame.f_back
    return str(frame.f_globals.get("__name__")).split(".")[0] == "dancedata"


def is_open(path: object) -> bool:
    """Return whether a process of these tests has a file open or mapped, or one below it."""
    folder, name = os.path.split(os.path.abspath(os.fspath(path)))  # type: ignore[call-overload]
    real = os.path.join(os.path.realpath(folder), name)
    return any(used == real or used.startswith(real + "/") for pid in _processes() for used in _used(pid))


#: Processes of others, by the time until which they are not looked at again.
_others: dict[str, float] = {}


def _processes() -> list[str]:
    found, now = [str(os.getpid())], time.monotonic()
    for pid in os.listdir("/proc"):
        if pid.isdigit() and pid != found[0] and _others.get(pid, 0.0) < now:
            _others[pid] = now + 5
            with suppress(OSError), open(f"/proc/{pid}/environ", "rb") as file:
                if b"DANCEDATA_TEST_WITHOUT=" in file.read():
                    found.append(pid)
                    del _others[pid]
    return found


def _used(pid: str) -> list[str]:
    used = []
    try:
        for number in os.listdir(f"/proc/{pid}/fd"):
            with suppress(OSError):
                used.append(os.readlink(f"/proc/{pid}/fd/{number}"))
        with open(f"/proc/{pid}/maps", encoding="utf-8", errors="surrogateescape") as maps:
            used += [line[line.index("/") :].rstrip("\n") for line in maps if "/" in line and ".so" not in line]
    except OSError:
        pass
    return used


def _rule_the_library() -> None:
    """Give the rules to those modules of the standard library that remove and rename for dancedata."""
    import pathlib
    import shutil

    ruled = ModuleType("os")
    ruled.__dict__.update(os.__dict__, **_rules())
    pathlib.os = shutil.os = ruled  # type: ignore[attr-defined]
    shutil._use_fd_functions = False  # type: ignore[attr-defined]  # it would open folders


class Loader(importlib.abc.Loader):
    """Loads a module of dancedata as another loader does, and gives it the stand-ins."""

    def __init__(self, real: importlib.abc.Loader, name: str) -> None:
        self._real, self._name = real, name

    def __getattr__(self, name: str) -> object:
        return getattr(self._real, name)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:
        return self._real.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        stand_ins = stand_in_modules()
        if self._name != "dancedata.core.system":
            self._real.exec_module(module)
            for name, stand_in in stand_ins.items():
                if module.__dict__.get(name) is sys.modules.get(name) is not None and stand_in is not None:
                    module.__dict__[name] = stand_in
            return
        before = {name: sys.modules.get(name) for name in stand_ins}
        sys.modules.update(stand_ins)  # type: ignore[arg-type]  # None: cannot be imported
        try:
            self._real.exec_module(module)
        finally:
            for name, real in before.items():
                sys.modules.pop(name)
                if real is not None:
                    sys.modules[name] = real
        if IS_WINDOWS:
            module.__dict__["_ignore_console_interrupts"] = _switch_of_the_console
        if "/proc" in MISSING:
            module.__dict__["open"] = _open_elsewhere


def _switch_of_the_console(ignore: bool) -> None:
    """Keep Ctrl-C from processes that are started, as Windows does; here by a mask: it comes late, not never."""
    import signal
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # Linux has it, and it would undo the mask
    signal.pthread_sigmask(signal.SIG_BLOCK if ignore else signal.SIG_UNBLOCK, {signal.SIGINT})


def _open_elsewhere(path: object, *args: object, **options: object) -> object:
    if str(path).startswith("/proc/"):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
    return open(path, *args, **options)  # type: ignore[call-overload]  # noqa: SIM115


class Finder(importlib.abc.MetaPathFinder):
    """Finds modules of dancedata as Python does."""

    def find_spec(self, name: str, path: object, target: object = None) -> importlib.machinery.ModuleSpec | None:
        if name.split(".")[0] != "dancedata":
            return None
        for finder in sys.meta_path:
            spec = None if finder is self else finder.find_spec(name, path, target)  # type: ignore[arg-type]
            if spec is not None:
                if spec.loader is not None:
                    spec.loader = Loader(spec.loader, name)  # type: ignore[arg-type]
                return spec
        return None


_made: dict[str, ModuleType | None] = {}


def stand_in_modules() -> dict[str, ModuleType | None]:
    """Return the modules that dancedata gets, by name; None for one that it cannot import."""
    if not _made:
        _made.update(_stand_ins())
        if IS_WINDOWS:
            _rule_the_library()
    return _made


if MISSING and __name__ == "sitecustomize":  # not where a test imports it for its lists
    # Modules that dancedata.core.system imports: they keep the real os.
    import ctypes  # noqa: F401
    import multiprocessing
    import pathlib  # noqa: F401
    import platform  # noqa: F401
    import threading  # noqa: F401

    if SPAWNS:
        multiprocessing.set_start_method("spawn")

    sys.meta_path.insert(0, Finder())

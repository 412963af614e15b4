"""Calls that not every system has are in core/system.py only; text files are written alike on every system."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.platforms.without.sitecustomize import CALLS

SYSTEM = ROOT / "dancedata" / "core" / "system.py"
MODULES = sorted((ROOT / "dancedata").rglob("*.py"))
#: Modules that one of the three systems lacks.
IMPORTS = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "msvcrt", "winreg", "posix", "nt", "_winapi"}
#: Names in modules: those that the modes take away, and others of one system's own.
NAMES = {
    **{f"{module}.{name}": name for module, name in CALLS.values() if name and module != "file"},
    **dict.fromkeys(("os.open", "os.name", "os.O_BINARY", "sys.platform", "os.pwritev", "os.fdatasync", "os.fchown")),
    **dict.fromkeys(("os.posix_fallocate", "os.posix_spawn", "os.getpgid", "os.chown", "os.getgid", "os.uname")),
    **dict.fromkeys(("os.sched_setaffinity", "os.getloadavg", "os.wait", "os.waitpid", "os.pipe2", "os.setxattr")),
    **dict.fromkeys(("mmap.MADV_SEQUENTIAL", "mmap.MAP_ANONYMOUS", "mmap.PROT_WRITE", "signal.sigwait")),
    **dict.fromkeys(("signal.setitimer", "signal.alarm", "signal.SIGUSR1", "signal.SIGPIPE", "signal.SIGCHLD")),
    **dict.fromkeys(("tempfile.NamedTemporaryFile", "socket.AF_UNIX", "time.tzset")),
}
#: Attributes of anything, and arguments, that mean different things or nothing elsewhere.
ATTRIBUTES = {"st_ctime", "st_ctime_ns", "st_blocks", "st_uid", "st_gid", "madvise", "pthread_sigmask"}
ARGUMENTS = {"pass_fds", "preexec_fn", "start_new_session", "process_group", "dir_fd", "src_dir_fd", "close_fds"}
PATHS = ("/proc/", "/dev/", "/sys/", "/tmp")  # noqa: S108


def problems(path: Path) -> Iterator[str]:
    """Yield the calls of one system in a module."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        what = ""
        if isinstance(node, ast.Import):
            what = ", ".join(alias.name for alias in node.names if alias.name in IMPORTS)
        elif isinstance(node, ast.ImportFrom):
            what = ", ".join(
                f"{node.module}.{alias.name}" for alias in node.names if f"{node.module}.{alias.name}" in NAMES
            ) or (node.module if node.module in IMPORTS else "")
        elif isinstance(node, ast.Attribute):
            name = ast.unparse(node)
            what = name if name in NAMES or node.attr in ATTRIBUTES else ""
        elif isinstance(node, ast.keyword) and node.arg in ARGUMENTS:
            what = node.arg
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith(PATHS):
            what = node.value
        if what:
            yield f"{path.relative_to(ROOT).as_posix()}:{node.lineno}: {what}"


def test_calls_of_one_system_are_in_one_module() -> None:
    assert [line for path in MODULES if path != SYSTEM for line in problems(path)] == []


@pytest.mark.parametrize(
    "code",
    [
        "import fcntl",
        "from os import pread",
        "os.open(path, 0)",
        "status.st_ctime_ns",
        "subprocess.Popen(command, pass_fds=[3])",
        "open('/proc/cpuinfo', encoding='utf-8')",
        "mmap.mmap(1, 0, flags=mmap.MAP_SHARED)",
        "sys.platform == 'linux'",
    ],
)
def test_the_search_finds_them(tmp_path: Path, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.platforms.test_calls.ROOT", tmp_path)
    (tmp_path / "a.py").write_text(code, encoding="utf-8")
    assert len(list(problems(tmp_path / "a.py"))) == 1


def text_problems(path: Path) -> Iterator[str]:
    """Yield where text is read or written in the encoding, or with the line ends, of one system."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
        given = {keyword.arg: keyword.value for keyword in node.keywords}
        if name in ("read_text", "write_text") and isinstance(node.func, ast.Attribute):
            # Methods of Path; those of exports and of files.atomic, with two arguments, write UTF-8 as it is.
            if ast.unparse(node.func.value) in ("folder", "self", "job.folder", "atomic") and len(node.args) > 1:
                continue
            missing = {"encoding"} if name == "read_text" else {"encoding", "newline"}
        elif name in ("open", "fdopen") and ast.unparse(node.func) != "tarfile.open":
            place = 0 if isinstance(node.func, ast.Attribute) and name == "open" else 1
            mode = given.get("mode") or (node.args[place] if len(node.args) > place else None)
            if not isinstance(mode, ast.Constant) or not isinstance(mode.value, str) or len(mode.value) > 3:
                if isinstance(node.func, ast.Attribute) or mode is not None:
                    continue  # another kind of open
                mode = ast.Constant("r")
            if "b" in mode.value or "closefd" in given:  # bytes, or standard streams
                continue
            missing = {"encoding", "newline"} if set(mode.value) & set("wxa") else {"encoding"}
        else:
            continue
        if missing - set(given):
            yield f"{path.relative_to(ROOT).as_posix()}:{node.lineno}: {name} without {sorted(missing - set(given))}"


def test_text_has_one_encoding_and_one_line_end() -> None:
    assert [line for path in MODULES for line in text_problems(path)] == []

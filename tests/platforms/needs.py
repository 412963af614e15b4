"""Which tests need a call of Linux themselves, beside what dancedata needs: skipped without it."""

import inspect
import re

import pytest

from dancedata.core import system
from tests.platforms.without.sitecustomize import IS_WINDOWS, MISSING, SPAWNS

#: What a test's text has, and what Windows has not.
NEEDS = {
    r"mkfifo|is_fifo|\bpipe: Path\b": "named pipes in folders",
    r"\bFORK\b|get_context\(\"fork\"\)|os\.fork\(": "processes that are forked",
    r"setrlimit|RLIMIT": "limits of the system on a process",
    r"no_file_beside|nfs|lock\"\)\.symlink_to": "locks on folders",
    r'"st_ino", "st_size", "st_mtime_ns"|song\.stat\(\)\.st_ino': "ctime, by which alone such files differ",
    r"_keeps_its_open_files_or_stops|_keep_the_files_mapped": "a dataset that is replaced while it is open",
    r"_fcntl": "flock, which the test replaces",
    r"SIGKILL\b.*signal [A-Z]|os\.kill, \(process\.call": "signals that end a process",
}
#: Tests whose DataLoaders have workers that inherit what the test set or defined.
INHERITS = re.compile(r"set_sharing_strategy\(|names\[\"OnTheFly\"\]")
#: Windows itself lacks more than its mode, in which tests have the signals and permissions of Linux.
IS_THERE = system.SYSTEM == "win32"
NEEDS_THERE = {
    r"in_processes\(": "processes that are forked",
    r"pthread_sigmask": "a mask of signals",
    r"SIGKILL|SIGALRM|SIGHUP|SIGXFSZ|killpg|start_new_session": "signals and groups of processes",
    r"\"/proc/|\"/dev/": "paths of Linux",
    r"\.chmod\(|geteuid|S_IMODE": "permissions of files",
    r"symlink_to": "links, which only administrators may make",
}
#: Tests of the promise that machines of a kind give the same bytes: without the processor's features none is made.
FEATURES = re.compile(r"has_reference|x86-64-v3|needs_reference")


def skip_what_cannot_run(items: list[pytest.Item]) -> None:
    """Mark tests that need what the mode takes away."""
    needs = {**(NEEDS if IS_WINDOWS or IS_THERE else {}), **(NEEDS_THERE if IS_THERE else {})}
    for item in items if MISSING or IS_THERE else ():
        text = inspect.getsource(item.function) if isinstance(item, pytest.Function) else ""
        reasons = [reason for pattern, reason in needs.items() if re.search(pattern, text)]
        if SPAWNS and INHERITS.search(text):
            reasons.append("workers that are forked")
        if ("/proc" in MISSING or IS_THERE) and FEATURES.search(text):
            reasons.append("the processor's features")
        if reasons:
            item.add_marker(pytest.mark.skip(reason=f"needs {' and '.join(reasons)}"))

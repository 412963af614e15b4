"""Text on a terminal: with colours; in pipes and logs as it is. Commands run in a pseudo-terminal."""

import fcntl
import os
import pty
import re
import struct
import sys
import termios
from pathlib import Path

import pytest

from dancedata.cli.cache import age_text
from dancedata.cli.terminal import say
from dancedata.comparison import Difference, Differences
from tests.commands import run
from tests.execution.test_progress import Terminal


def on_a_terminal(columns: int, *args: object, **environment: str) -> str:
    """Return what a command writes to a terminal of this width."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ |= {"TERM": "xterm-256color", **environment}
        os.environ.pop("COLUMNS", None)
        os.execv(sys.executable, [sys.executable, "-m", "dancedata", *map(str, args)])
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    text = b""
    while True:
        try:
            text += os.read(terminal, 65_536)
        except OSError:  # the command has ended
            break
    os.close(terminal)
    os.waitpid(pid, 0)
    return text.decode().replace("\r\n", "\n")


def plain(text: str) -> str:
    return re.sub(r"\x1b\[[\d;]*m", "", text)


def test_colours_on_a_terminal_alone(tmp_path: Path):
    there = tmp_path / ("long " * 30)
    written = on_a_terminal(80, "info", there)
    in_a_pipe = run("info", there, code=1).stderr
    assert plain(written) == in_a_pipe, "lines are not broken: what is copied is whole"
    assert written.startswith("\x1b[1;31merror\x1b[0m: ")
    assert "\x1b" not in in_a_pipe
    assert not re.search(r"\x1b\[[\d;]*3\d", on_a_terminal(80, "info", there, NO_COLOR="1"))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("error: no", "\x1b[1;31merror\x1b[0m: no"),
        ("  bad: no", "\x1b[1;31m  bad\x1b[0m: no"),
        ("  look: 3 clips", "\x1b[33m  look\x1b[0m: \x1b[1m3\x1b[0m clips"),
        ("note: no clips", "\x1b[2mnote: no clips\x1b[0m"),
        ("1,188 clips, 24 %, 3.5 s", "\x1b[1m1,188\x1b[0m clips, \x1b[1m24\x1b[0m %, \x1b[1m3.5\x1b[0m s"),
        ("d/2 gBR_1 v1.2 a-3 3x http://127.0.0.1:80/ [b]", "d/2 gBR_1 v1.2 a-3 3x http://127.0.0.1:80/ [b]"),
        ("the errors: none", "the errors: none"),
        ("", ""),
    ],
)
def test_kinds_and_numbers(text: str, shown: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "20")
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    say(text)
    assert terminal.getvalue() == f"{shown}\n"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (5, "less than a minute"), (60, "1 minute"), (15 * 60, "15 minutes"), (90 * 60, "90 minutes"),
        (120 * 60, "2 hours"), (36 * 3600, "36 hours"), (48 * 3600, "2 days"), (30 * 86400, "30 days"),
    ],
)  # fmt: skip
def test_times_that_have_passed(seconds: int, text: str):
    assert age_text(seconds / 86400) == text


def test_differences_of_one_kind_are_one_line():
    differences = [
        Difference("store", "fps: 30, 60"),
        *(Difference("store", f"genre_ids.{name}: {k}, null") for k, name in enumerate(("gBR", "gHO", "gLO"))),
        Difference("fields", "dtype float32, float16", ("edge151",)),
        Difference("fields", "dtype float32, float16", ("librosa35",)),
        Difference("recipe", "windows.stride_frames: 15, 30"),
        Difference("clips", "1 clip only in A", ("a",)),
    ]
    assert Differences(differences).lines() == [
        "store: fps: 30, 60",
        "store: 3 keys of genre_ids differ: gBR: 0, null; gHO: 1, null, ...",
        "fields: dtype float32, float16: edge151, librosa35",
        "recipe: windows.stride_frames: 15, 30",
        "clips: 1 clip only in A: a",
    ]
    assert Differences().lines() == []

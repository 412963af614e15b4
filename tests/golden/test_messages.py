"""The file of error texts: what it holds, when a test fails, when entries come and go."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.messages import GOLDEN, normalised, parse, render

MODULE = """
import pytest
from messages import raises_message

@pytest.mark.parametrize("k", range(4))
def test_texts(k, tmp_path):
    for text in (f"{tmp_path}/a: no {k}", "two\\n\\n  lines"):
        with raises_message(ValueError):
            raise ValueError(text)
"""
CONFTEST = """
from pathlib import Path
from messages import Messages, pytest_addoption

def pytest_configure(config):
    config.pluginmanager.register(Messages(config, {"ROOT": Path(__file__).parent.parent}))
"""
ENTRY = """
tests/test_one.py::test_texts[{k}]
    ValueError: TMP/a: no {k}

tests/test_one.py::test_texts[{k}] #2
    ValueError: two

      lines
"""


def test_the_file_is_as_it_is_written() -> None:
    text = GOLDEN.read_text(encoding="utf-8")
    assert render(parse(text)) == text


def test_folders_of_a_run_are_names() -> None:
    text = "/t/base/popen-gw1/test_a0/x.h5 and /t/base/test_a0, /t/base2, /r/docs  \n  /t/base \n"
    expected = "TMP/x.h5 and TMP, /t/base2, ROOT/docs\n  TMP"
    assert normalised(text, {"/t/base": "TMP", "/r": "ROOT"}) == expected


@pytest.mark.parametrize("workers", ["0", "2"])
def test_a_run_compares_and_writes(tmp_path: Path, workers: str) -> None:
    tests = tmp_path / "tests"
    golden = tests / "golden" / "messages.txt"
    golden.parent.mkdir(parents=True)
    (tests / "messages.py").write_bytes((GOLDEN.parents[1] / "messages.py").read_bytes())
    (tests / "conftest.py").write_text(CONFTEST)
    (tests / "test_one.py").write_text(MODULE)
    (tests / "test_two.py").write_text("")
    (tmp_path / "pytest.ini").write_text("[pytest]\ntestpaths = tests\npythonpath = tests\n")

    def run(*options: str) -> str:
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            "-p",
            "xdist.plugin",
            "-n",
            workers,
            *options,
        ]
        environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        return done.stdout.splitlines()[-1]

    def entries() -> str:
        return golden.read_text(encoding="utf-8").partition("\n")[2]

    whole = "".join(ENTRY.format(k=k) for k in range(4))
    if not int(workers):
        assert run().startswith("4 failed")
    assert run("--update-messages").startswith("4 passed")
    assert entries() == whole

    golden.write_text(golden.read_text().replace("no 2", "not 2"))
    assert run().startswith("1 failed, 3 passed")
    (tests / "test_one.py").write_text(MODULE.replace("range(4)", "range(3)"))
    if not int(workers):
        run("--update-messages", "tests/test_one.py")
        assert entries() == whole, "only a complete run knows that a test is gone"
    run("--update-messages")
    assert entries() == "".join(ENTRY.format(k=k) for k in range(3))

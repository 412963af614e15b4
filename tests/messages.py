"""Whole error texts, compared with tests/golden/messages.txt, by test and order in the test.

`pytest --update-messages` writes the file. An entry is dropped if its test passed without it, or, on a run of all
tests where all test modules load, if there is no such test.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from dancedata.core.version import __version__

GOLDEN = Path(__file__).resolve().parent / "golden" / "messages.txt"
HEAD = "# Error texts that tests expect. Written by `pytest --update-messages`; see tests/messages.py.\n"
E = TypeVar("E", bound=BaseException)
#: A test and the place of the error in it, from 1.
Key = tuple[str, int]


def parse(text: str) -> dict[Key, str]:
    """Return the entries of the file: a line with the test, then the indented text."""
    entries = {}
    for entry in re.split(r"\n(?=[^\s#])", text)[1:]:
        name, _, body = entry.partition("\n")
        node, _, number = name.partition(" #")
        entries[node, int(number or 1)] = re.sub(r"^    ", "", body, flags=re.MULTILINE).rstrip()
    return entries


def render(entries: dict[Key, str]) -> str:
    """Return the text of the file, sorted."""
    parts = [HEAD]
    for (node, number), text in sorted(entries.items()):
        parts += [f"\n{node}{f' #{number}' if number > 1 else ''}\n"]
        parts += [f"    {line}".rstrip() + "\n" for line in text.split("\n")]
    return "".join(parts)


def normalised(text: str, folders: dict[str, str]) -> str:
    """Return a text with folders, version and hashes of files by name, without spaces at the ends of lines.

    Files that are built have other hashes on other processors.
    """
    for folder, name in folders.items():
        # A test's own temporary folder has a number, which depends on the order of the tests; a shared one has a key.
        rest = r"([/\\]popen-gw\d+|[/\\]once)?([/\\][\w.+-]+)?" if name == "TMP" else ""
        text = re.sub(re.escape(folder) + rest + r"(?![\w-])", name, text)
        if os.sep != "/":
            text = re.sub(rf"{name}[\w.+\\-]+", lambda path: path.group().replace(os.sep, "/"), text)
    text = text.replace(f"dancedata {__version__}", "dancedata VERSION")
    text = re.sub(r"\b[0-9a-f]{12}\.\.\.", "HASH...", text)
    return re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE).rstrip()


class Messages:
    """Plug-in of pytest: the texts of a run. Workers of pytest-xdist hand theirs to the controller."""

    current: Messages

    def __init__(self, config: pytest.Config, folders: dict[str, Path]) -> None:
        self.config = config
        self.folders = folders
        self.update = bool(config.getoption("update_messages"))
        self.expected = parse(GOLDEN.read_text(encoding="utf-8")) if GOLDEN.exists() else {}
        self.texts: dict[Key, str] = {}
        self.collected: set[str] = set()
        self.passed: set[str] = set()
        # Tests that the command line leaves out, or that need missing files or packages, are not stale.
        option = config.option
        chosen = (option.keyword, option.deselect, option.ignore, option.ignore_glob, getattr(option, "lf", False))
        from_testpaths = config.args_source is pytest.Config.ArgsSource.TESTPATHS
        self.whole = from_testpaths and not any(chosen) and all(folder.exists() for folder in folders.values())
        self.loaded = True
        self.node, self.number = "", 0
        Messages.current = self

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        self.collected.update(item.nodeid for item in items)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self.loaded = self.loaded and report.passed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        self.node, self.number = item.nodeid, 0
        base = item.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]  # the fixture's own factory
        base = base.parent if base.name.startswith("popen-gw") else base
        self.names = {str(base): "TMP"} | {str(folder): name for name, folder in self.folders.items()}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" and report.passed:
            self.passed.add(report.nodeid)

    def check(self, found: str) -> None:
        """Compare a text with its entry, or keep it for the file."""
        __tracebackhide__ = True
        self.number += 1
        key = self.node, self.number
        text = self.texts[key] = normalised(found, self.names)
        if self.update:
            return
        if key not in self.expected:
            pytest.fail(f"no entry in {GOLDEN.name}: run pytest --update-messages\n{text}")
        if text != self.expected[key]:
            pytest.fail(
                f"another error text (pytest --update-messages)\nexpected {self.expected[key]}\nfound    {text}"
            )

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if not self.update:
            return
        if hasattr(self.config, "workeroutput"):
            self.config.workeroutput["messages"] = [
                [[*key, text] for key, text in self.texts.items()],
                sorted(self.collected) if self.config.workerinput["workerid"] == "gw0" else [],  # type: ignore[attr-defined]
                self.loaded,
            ]
            return
        kept = self.expected | self.texts
        stale = {key for key in self.expected if key[0] in self.passed and key not in self.texts}
        if self.whole and self.loaded and self.collected:
            stale |= {key for key in kept if key[0] not in self.collected}
        GOLDEN.parent.mkdir(exist_ok=True)
        GOLDEN.write_text(render({key: text for key, text in kept.items() if key not in stale}), encoding="utf-8")

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take what a worker has, before the controller's session ends."""
        texts, collected, loaded = getattr(node, "workeroutput", {}).get("messages", ([], [], False))
        self.texts.update({(name, number): text for name, number, text in texts})
        self.collected.update(collected)
        self.loaded = self.loaded and loaded


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that writes the file."""
    parser.addoption("--update-messages", action="store_true", help="write tests/golden/messages.txt")


@contextmanager
def raises_message(error: type[E]) -> Iterator[pytest.ExceptionInfo[E]]:
    """Expect an error with the text that tests/golden/messages.txt has for this place."""
    __tracebackhide__ = True
    with pytest.raises(error) as caught:
        yield caught
    Messages.current.check(f"{type(caught.value).__name__}: {caught.value}")


def same_text(found: str) -> None:
    """Compare a text, such as the stderr of a command, with that of tests/golden/messages.txt for this place."""
    __tracebackhide__ = True
    Messages.current.check(found)

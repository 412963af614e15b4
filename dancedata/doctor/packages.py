"""Checks of Python and of the packages: those that dancedata needs, and those of its extras."""

from __future__ import annotations

import importlib.metadata
import json
import platform
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from dancedata.core.packages import install, needed_by
from dancedata.core.version import __version__
from dancedata.doctor.finding import Finding, failed, note, ok

if TYPE_CHECKING:
    from packaging.requirements import Requirement

#: What each extra is for.
EXTRAS = {
    "torch": "torch datasets",
    "jukebox": "Jukebox's embeddings",
    "hf": "encoders of the Hugging Face layout",
    "beats": "beats and downbeats by a network",
    "dask": "builds on a cluster",
    "smpl": "body models by smplx",
    "report": "figures of motion and features",
    "video": "videos of clips",
}
#: Modules of distributions that have another name.
_MODULES = {"dask": "distributed", "pyyaml": "yaml", "imageio-ffmpeg": "imageio_ffmpeg", "pillow": "PIL"}
_IMPORT_S = 120
# Each in turn, in one process: a package that crashes ends this process, and the last name is that of the package.
_IMPORT = """
import importlib, json, os, sys
# Whatever a package prints goes elsewhere.
report = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
for name in json.loads(sys.argv[1]):
    print(json.dumps([name, None]), file=report, flush=True)
    try:
        importlib.import_module(name)
        problem = ""
    except BaseException as error:
        problem = f"{type(error).__name__}: {error}"
    print(json.dumps([name, problem]), file=report, flush=True)
"""


def check_python() -> Iterator[Finding]:
    """Compare Python's version with those that dancedata is for."""
    text = f"{platform.python_version()} at {sys.executable}; dancedata {__version__}"
    allowed = _requires_python()
    if allowed and not _fits(allowed, platform.python_version()):
        yield failed("Python", f"{text}, which needs Python {allowed}", "make an environment with such a version")
    else:
        yield ok("Python", text)


def check_packages(required: Sequence[str]) -> Iterator[Finding]:
    """Compare the versions of the packages that dancedata cannot do without."""
    needed = needed_by("", required)
    if not needed:
        fix = "install it with pip install ., or with pip install -e . in a checkout"
        yield note("packages", "dancedata is not installed as a distribution, so that its needs are unknown", fix)
        return
    problems = _problems(needed)
    if problems:
        yield failed("packages", "; ".join(problems), "pip install -c constraints.txt . installs what is missing")
    else:
        yield ok("packages", ", ".join(f"{r.name} {importlib.metadata.version(r.name)}" for r in needed))


def check_extras(required: Sequence[str]) -> Iterator[Finding]:
    """Compare and import the packages of every extra: a line for each."""
    members = {extra: needed_by(extra, required) for extra in EXTRAS}
    members = {extra: needed for extra, needed in members.items() if needed}
    present = {extra: not any(_is_missing(r) for r in needed) for extra, needed in members.items()}
    wanted = [r for extra, needed in members.items() if present[extra] for r in needed]
    broken = import_problems(dict.fromkeys(_MODULES.get(r.name, r.name) for r in wanted))
    for extra, needed in members.items():
        name, command = f"extra {extra}", install(extra, required)
        if not present[extra]:
            missing = ", ".join(r.name for r in needed if _is_missing(r))
            yield note(name, f"not installed ({missing}); it is for {EXTRAS[extra]}", command)
            continue
        problems = _problems(needed)
        problems += [f"{m}: {p}" for m in (_MODULES.get(r.name, r.name) for r in needed) if (p := broken.get(m))]
        if problems:
            yield failed(name, "; ".join(problems), f"{command} with the versions of constraints.txt")
        else:
            yield ok(name, ", ".join(f"{r.name} {importlib.metadata.version(r.name)}" for r in needed))


def import_problems(modules: Iterable[str]) -> dict[str, str]:
    """Import modules in another process, and return why for those that cannot be, or that end the process."""
    left = list(modules)
    problems: dict[str, str] = {}
    while left:
        # The command is ours; the names are those of the distribution's metadata.
        done = subprocess.run(  # noqa: S603
            [sys.executable, "-P", "-c", _IMPORT, json.dumps(left)],
            capture_output=True, text=True, errors="replace", check=False, timeout=_IMPORT_S,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('["')]
        problems |= {name: problem for name, problem in lines if problem}
        if not lines or lines[-1][1] is not None:  # the last one was imported, or failed as it should
            break
        died = lines[-1][0]
        problems[died] = f"the process that imports it ends with status {done.returncode}"
        left = left[left.index(died) + 1 :]
    return problems


def _requires_python() -> str:
    try:
        about = importlib.metadata.metadata("dancedata")
    except importlib.metadata.PackageNotFoundError:
        return ""
    return str(about["Requires-Python"]) if "Requires-Python" in about else ""


def _fits(allowed: str, version: str) -> bool:
    from packaging.specifiers import SpecifierSet

    return SpecifierSet(allowed).contains(version, prereleases=True)


def _is_missing(requirement: Requirement) -> bool:
    try:
        importlib.metadata.version(requirement.name)
    except importlib.metadata.PackageNotFoundError:
        return True
    return False


def _problems(needed: Sequence[Requirement]) -> list[str]:
    found = []
    for requirement in needed:
        if _is_missing(requirement):
            found.append(f"{requirement.name} is not installed")
            continue
        version = importlib.metadata.version(requirement.name)
        if not requirement.specifier.contains(version, prereleases=True):
            found.append(f"{requirement.name} {version} is installed, {requirement.specifier} is needed")
    return found

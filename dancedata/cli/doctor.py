"""dancedata doctor: checks of an installation, in half a minute and without leftovers."""

from __future__ import annotations

import errno
import importlib.metadata
import os
import platform
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from dancedata.cli.terminal import say
from dancedata.core.packages import MODULES, install, needed_by, requirements
from dancedata.core.text import counted, json_text, shown
from dancedata.core.version import __version__

if TYPE_CHECKING:
    from packaging.requirements import Requirement

#: Bytes: a dataset of slices of AIST++ with librosa35 takes about this much of the cache.
_AMPLE, _LEAST = 10 * 10**9, 10**8
_RATE = 22_050
#: Formats that songs have, by their extension; the encoding that is written of each.
_FORMATS = {"wav": "PCM_16", "flac": "PCM_16", "ogg": "VORBIS", "mp3": "MPEG_LAYER_III"}
#: Two songs, four clips of 5 s.
_TINY = {
    "dataset.synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 5, "split": "all"},
    "windows": {"length_s": 4, "stride_s": 0.5},
}
_REPORT = "report it with the output of doctor --json"


Status = Literal["ok", "note", "failed"]


@dataclass(frozen=True)
class Finding:
    """The result of one check; "note" for a limit of the installation that breaks nothing."""

    check: str
    status: Status
    found: str
    fix: str = ""

    def __str__(self) -> str:
        status = "FAILED" if self.status == "failed" else self.status
        return f"{status:<6}  {self.check}: {self.found}{'; ' * bool(self.fix)}{self.fix}"


def run_doctor(*, as_json: bool) -> bool:
    """Check the installation and print a line for each check, or JSON at the end; return whether it works."""
    findings: list[Finding] = []
    for finding in diagnose():
        findings.append(finding)
        if not as_json:
            say(str(finding))
    count = Counter(finding.status for finding in findings)
    works = not count["failed"]
    if as_json:
        typer.echo(json_text({"ok": works, "checks": [asdict(finding) for finding in findings]}))
    elif works:
        say(f"this installation works ({counted(count['note'], 'note')})")
    else:
        say(f"{counted(count['failed'], 'check')} failed")
    return works


def diagnose() -> Iterator[Finding]:
    """Yield the result of each check as soon as it ends.

    A check that raises any exception has failed; the others still run. Checks import dancedata's rooms themselves, so
    that a missing package is a result.
    """
    required = requirements()
    checks: dict[str, Callable[[], Iterator[Finding]]] = {
        "packages": lambda: check_packages(required),
        "cache": check_cache,
        "music": check_music,
        "workers": check_workers,
        "build": check_build,
    }
    for name, check in checks.items():
        try:
            yield from check()
        except Exception as error:  # noqa: BLE001  (a broken installation raises anything)
            fix = "see the lines above; if none of them has failed, " + _REPORT
            if isinstance(error, ImportError):
                fix = "pip install -c constraints.txt . installs what is missing"
            yield Finding(name, "failed", shown(f"{type(error).__name__}: {error}", 600), fix)


def check_packages(required: Sequence[str]) -> Iterator[Finding]:
    """Compare the installed versions with those that dancedata and each of its extras need."""
    yield Finding("Python", "ok", f"{platform.python_version()} at {sys.executable}; dancedata {__version__}")
    if not required:
        fix = "install it with pip install ., or with pip install -e . in a checkout"
        yield Finding("packages", "note", "dancedata is not installed, so that its needs are unknown", fix)
        return
    text, problems, _ = _versions(needed_by("", required))
    fix = "pip install -c constraints.txt . installs what is missing" if problems else ""
    yield Finding("packages", "failed" if problems else "ok", problems or text, fix)
    for extra in MODULES:
        if needed := needed_by(extra, required):
            text, problems, missing = _versions(needed)
            status: Status = "note" if missing else "failed" if problems else "ok"
            yield Finding(f"extra {extra}", status, problems or text, install(extra, required) if problems else "")


def _versions(needed: Sequence[Requirement]) -> tuple[str, str, bool]:
    """Return the versions of packages, their problems, and whether one is missing."""
    installed: list[str] = []
    problems: list[str] = []
    missing = False
    for requirement in needed:
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            problems.append(f"{requirement.name} is not installed")
            missing = True
            continue
        installed.append(f"{requirement.name} {version}")
        if not requirement.specifier.contains(version, prereleases=True):
            problems.append(f"{installed[-1]} is installed, {requirement.specifier} is needed")
    return ", ".join(installed), "; ".join(problems), missing


def check_cache() -> Iterator[Finding]:
    """Write, lock and remove a file in the folder of the cache, or in its first existing parent."""
    from dancedata.execution.cache import ENVIRONMENT, default_cache

    fix = f"set {ENVIRONMENT} to a writable folder with free space"
    root = default_cache().absolute()
    existing = next(folder for folder in (root, *root.parents) if os.path.lexists(folder))
    text = str(root) if existing == root else f"{root}, which is made by the first build"
    try:
        for folder, _, _ in os.walk(root):  # one of another user's folders is enough to stop a build
            if not os.access(folder, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), folder)
        with tempfile.TemporaryDirectory(prefix=".dancedata-doctor-", dir=existing) as folder:
            has_locks = _locks_work(Path(folder) / "lock")
        free = shutil.disk_usage(existing).free
    except OSError as error:
        yield Finding("cache", "failed", f"{root} cannot be written: {error}", fix)
        return
    text += f"; {free / 1e9:.1f} GB free; {'locks work' if has_locks else 'the file system has no locks'}"
    status: Status = "ok" if has_locks and free >= _AMPLE else "note"
    if free < _LEAST:
        status = "failed"
    elif not has_locks:
        fix = f"builds at once may compute the same twice: set {ENVIRONMENT} to another file system"
    elif free < _AMPLE:
        fix = "make space before a large build, or dancedata cache prune"
    yield Finding("cache", status, text, "" if status == "ok" else fix)


def _locks_work(path: Path) -> bool:
    """Return whether another descriptor of a file, as of another process, sees a lock on it."""
    from dancedata.core.system import open_file
    from dancedata.files.locks import lock_file, unlock

    first, second = open_file(path, os.O_CREAT | os.O_RDWR), open_file(path, os.O_RDWR)
    try:
        return lock_file(first, wait=False) is True and lock_file(second, wait=False) is False
    finally:
        unlock(second)
        unlock(first)


def check_music() -> Iterator[Finding]:
    """Write a second of music in every format, and decode it as a build does."""
    import numpy as np
    import soundfile

    from dancedata.music.signal import load_audio

    sine = 0.5 * np.sin(2 * np.pi * 440 * np.arange(_RATE) / _RATE)
    readable, problems = [], []
    with tempfile.TemporaryDirectory(prefix="dancedata-doctor-") as folder:
        for suffix, encoding in _FORMATS.items():
            path = Path(folder) / f"a.{suffix}"
            try:
                soundfile.write(path, sine, _RATE, format=suffix.upper(), subtype=encoding)
                peak = float(np.abs(load_audio(path).samples).max())
                if not 0.4 < peak < 0.6:
                    raise ValueError("decoded to other samples")
                readable.append(suffix)
            except Exception as error:  # noqa: BLE001  (a decoder that is broken raises anything)
                problems.append(f"{suffix} ({error})")
    text = f"libsndfile {soundfile.__libsndfile_version__} writes and reads {', '.join(readable)}"
    fix = ""
    if problems:
        text += f", not {'; '.join(problems)}"
        fix = "pip install --upgrade soundfile, or convert such songs to wav or flac"
    yield Finding("music", "failed" if "wav" not in readable else "note" if problems else "ok", text, fix)


def check_workers() -> Iterator[Finding]:
    """Start two worker processes, and compare the processor's instructions that they compute with."""
    from dancedata.execution.arithmetic import expected
    from dancedata.execution.progress import Progress
    from dancedata.execution.units import run_units

    workers = run_units(_about_worker, [(0,), (1,)], jobs=2, label="workers", progress=Progress(quiet=True))
    instructions = " and ".join(sorted({used for _, used in workers}))
    if instructions != expected():
        yield Finding("workers", "failed", f"they compute with {instructions}, not {expected()}", _REPORT)
    elif os.getpid() in {pid for pid, _ in workers}:
        yield Finding("workers", "note", "cannot start workers from a daemonic process")
    else:
        yield Finding("workers", "ok", f"start, and compute with {instructions}; {os.cpu_count()} cores")


def _about_worker(number: int) -> tuple[int, str]:
    """Return a worker's process id and instructions; units are numbered."""
    from dancedata.execution import arithmetic

    return os.getpid(), arithmetic.here()


def check_build() -> Iterator[Finding]:
    """Build four short clips of the demo by two worker processes, and check the dataset."""
    from dancedata.building.commands import build, check

    with tempfile.TemporaryDirectory(prefix="dancedata-doctor-") as name:
        folder = Path(name)
        built = build(
            "demo", folder / "source", folder / "dataset", overrides=_TINY, jobs=2, cache=folder / "cache",
            progress=False,
        )  # fmt: skip
        errors = [str(problem) for problem in check(built.path, progress=False) if problem.severity == "error"]
    text, fix = f"{built.counts['all']['windows']} windows were built by two workers, and checked", ""
    if errors:
        text, fix = f"a dataset that was just built is damaged: {'; '.join(errors)}", _REPORT
    yield Finding("build", "failed" if errors else "ok", text, fix)

"""dancedata info without a name: versions, extras, cache and free space, in half a second and without leftovers."""

import errno
import importlib.metadata
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from dancedata.cli.command import Output
from dancedata.core.packages import MODULES, install, needed_by, requirements
from dancedata.core.text import counted
from dancedata.core.version import __version__

if TYPE_CHECKING:
    from packaging.requirements import Requirement

#: Bytes: a dataset of slices of AIST++ with librosa35 takes about this much of the cache.
_AMPLE, _LEAST = 10 * 10**9, 10**8
#: Formats that songs have, and the encoding that is written of each.
_FORMATS = {"wav": "PCM_16", "flac": "PCM_16", "ogg": "VORBIS", "mp3": "MPEG_LAYER_III"}
_INSTALL = "pip install -c constraints.txt . installs what is missing"
Status = Literal["ok", "note", "failed"]


class Finding(NamedTuple):
    """The result of one check; "note" for a limit of the installation that breaks nothing."""

    check: str
    status: Status
    found: str
    fix: str = ""

    def __str__(self) -> str:
        head = {"ok": "", "note": "note: ", "failed": "error: "}[self.status]
        return f"{head}{self.check}: {self.found}{'; ' * bool(self.fix)}{self.fix}"


def installation() -> Output:
    """Check the installation."""
    findings = [*check_packages(requirements()), check_cache(), check_music()]
    failed = sum(finding.status == "failed" for finding in findings)
    end = f"{counted(failed, 'check')} failed" if failed else "this installation works; try: dancedata build demo"
    return Output(
        lambda: {"checks": [finding._asdict() for finding in findings]},
        lambda: "\n".join([*map(str, findings), end]),
        ok=not failed,
    )


def check_packages(required: Sequence[str]) -> Iterator[Finding]:
    """Compare the installed versions with those that dancedata and each of its extras need."""
    yield Finding("Python", "ok", f"{platform.python_version()} at {sys.executable}; dancedata {__version__}")
    if not required:
        fix = "install it with pip install ., or with pip install -e . in a checkout"
        yield Finding("packages", "note", "dancedata is not installed, so that its needs are unknown", fix)
        return
    yield _versions("packages", needed_by("", required), _INSTALL)
    for extra in MODULES:
        if needed := needed_by(extra, required):
            yield _versions(f"extra {extra}", needed, install(extra, required))


def _versions(check: str, needed: Sequence["Requirement"], fix: str) -> Finding:
    """Compare the versions of packages; a missing one of an extra is a note."""
    installed: list[str] = []
    problems: list[str] = []
    status: Status = "failed"
    for requirement in needed:
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            problems.append(f"{requirement.name} is not installed")
            status = "failed" if check == "packages" else "note"
            continue
        installed.append(f"{requirement.name} {version}")
        if not requirement.specifier.contains(version, prereleases=True):
            problems.append(f"{installed[-1]} is installed, {requirement.specifier} is needed")
    if problems:
        return Finding(check, status, "; ".join(problems), fix)
    return Finding(check, "ok", ", ".join(installed))


def check_cache() -> Finding:
    """Write, lock and remove a file in the folder of the cache, or in its first existing parent."""
    from dancedata.execution.cache import ENVIRONMENT, default_cache

    fix = f"set {ENVIRONMENT} to a writable folder with free space"
    root = default_cache().absolute()
    existing = next(folder for folder in (root, *root.parents) if os.path.lexists(folder))
    try:
        if not os.access(existing, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(existing))
        with tempfile.TemporaryDirectory(prefix=".dancedata-info-", dir=existing) as folder:
            has_locks = _locks_work(Path(folder) / "lock")
        free = shutil.disk_usage(existing).free
    except OSError as error:
        return Finding("cache", "failed", f"{root} cannot be written: {error}", fix)
    text = str(root) if existing == root else f"{root}, which is made by the first build"
    text += f"; {free / 1e9:.1f} GB free; {'locks work' if has_locks else 'the file system has no locks'}"
    if not has_locks:
        fix = f"builds at once may compute the same twice: set {ENVIRONMENT} to another file system"
    elif free >= _AMPLE:
        return Finding("cache", "ok", text)
    elif free >= _LEAST:
        fix = "make space before a large build, or dancedata cache prune"
    return Finding("cache", "failed" if free < _LEAST else "note", text, fix)


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


def check_music() -> Finding:
    """Say which formats of songs the installed libsndfile has."""
    try:
        import soundfile
    except (ImportError, OSError) as error:
        return Finding("music", "failed", f"{type(error).__name__}: {error}", _INSTALL)
    missing = [suffix for suffix, subtype in _FORMATS.items() if not soundfile.check_format(suffix.upper(), subtype)]
    known = ", ".join(suffix for suffix in _FORMATS if suffix not in missing)
    text = f"libsndfile {soundfile.__libsndfile_version__} reads {known}"
    if not missing:
        return Finding("music", "ok", text)
    fix = "pip install --upgrade soundfile, or convert such songs to wav or flac"
    return Finding("music", "note", f"{text}, not {', '.join(missing)}", fix)

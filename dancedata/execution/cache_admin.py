"""Listing, pruning and verification of the entries of a cache."""

import math
import os
import re
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from stat import S_ISREG
from typing import Any

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.system import open_file
from dancedata.core.text import listed
from dancedata.files import cache_files as files
from dancedata.files.locks import is_abandoned, lock_file, remove_locked, unlock

_UNITS = {"b": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12}
_AGES = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_NUMBER = re.compile(r"(?P<number>[0-9]{1,15}(?:\.[0-9]{1,15})?)")
_AGE = re.compile(rf"{_NUMBER.pattern}\s*(?P<unit>[smhdw])")
_SIZE = re.compile(rf"{_NUMBER.pattern}\s*(?P<unit>b|[kmgt]b?)")
#: Characters of a wrong value that a message shows.
_SHOWN = 40


@dataclass(frozen=True)
class Entry:
    """A file of the cache."""

    path: Path
    stage: str
    size: int  # bytes on disk, in whole blocks
    used: float  # last use, seconds since 1970, to the hour
    modified: float  # an entry that was changed since is not removed


@dataclass
class Pruned:
    """Result of `prune`: removed entries, also those that a dry run would remove, and kept ones."""

    removed: int = 0
    removed_bytes: int = 0
    kept: int = 0
    kept_bytes: int = 0
    in_use: int = 0  # kept, as a build or training uses them
    swept: int = 0  # files left by killed processes, removed as well
    paths: list[Path] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {**self.__dict__, "paths": [str(path) for path in self.paths]}


def _require_cache(root: Path) -> None:
    """Raise UsageError if a folder holds files and is not a cache."""
    if files.is_cache(root) or not any(names for _, _, names in os.walk(root)):
        return
    names = sorted(os.listdir(root))
    raise UsageError("this folder is not a cache of dancedata; nothing was removed", where=root, found=listed(names),
                     allowed=f"a folder with {files.MARKER} in it, which builds write",
                     fix="name the cache's folder: --cache DIR, or $DANCEDATA_CACHE")  # fmt: skip


def entries(root: Path) -> Iterator[Entry]:
    """List all entries of a cache; entries that vanish during the listing are skipped."""
    for stage in _folders(root):
        if stage.name not in files.STAGES:
            continue
        for prefix in _folders(stage):
            for file in _scanned(prefix):
                match = files.ENTRY.fullmatch(file.name)
                if match is not None and match["two"] == prefix.name:
                    yield from _entry(file, stage.name)
    # Files of datasets that were fetched from addresses, and unfinished parts of some.
    for folder in _folders(root / files.DATASETS):
        match = files.FETCHED.fullmatch(folder.name)
        for file in _scanned(folder) if match is not None else ():
            # dataset.json stays: with it the rest is fetched again when it is needed.
            if file.name not in ("dataset.json", "publication.json"):
                yield from _entry(file, files.DATASETS, folder.parent / f"{match['sha256']}.json")  # type: ignore[index]


def _entry(file: os.DirEntry[str], stage: str, opened: Path | None = None) -> Iterator[Entry]:
    """Yield a regular file as an entry, unless it has vanished; `opened` is a file that each use changes."""
    with suppress(OSError):
        stat = file.stat(follow_symlinks=False)
        if S_ISREG(stat.st_mode):
            used = stat.st_mtime if opened is None else max(opened.stat().st_mtime, stat.st_mtime)
            size = max(stat.st_size, stat.st_blocks * 512)  # bytes on the disk
            yield Entry(Path(file.path), stage, size, used, stat.st_mtime)


def cache_json(root: Path) -> dict[str, Any]:
    """Return the output of `cache --json`: entries, bytes, and the least and most days without use, by stage."""
    _require_cache(root)
    now, stages = time.time(), defaultdict[str, list[Entry]](list)
    for entry in entries(root):
        stages[entry.stage].append(entry)
    about: dict[str, dict[str, Any]] = {}
    for name, held in sorted(stages.items()):
        used = [entry.used for entry in held]
        days = [round(max(0.0, now - at) / 86400, 5) for at in (max(used), min(used))]
        about[name] = {"entries": len(held), "bytes": sum(entry.size for entry in held), "days_unused": days}
    sums = {key: sum(stage[key] for stage in about.values()) for key in ("entries", "bytes")}
    return {"path": str(root), **sums, "stages": about}


def prune(
    root: Path, *, older_than_s: float | None = None, max_bytes: int | None = None, dry: bool = False
) -> Pruned:
    """Remove entries by age, then the least recently used beyond a size, but those in use; with `dry`, say which."""
    if older_than_s is None and max_bytes is None:
        raise UsageError("no rule for removal", fix="give --older-than 30d, --max-size 50GB, or both")
    _require_cache(root)
    now = time.time()
    result = Pruned(swept=0 if dry else files.sweep(root))
    # The time of a use is kept to the hour.
    since = oldest_running(root) - files.USE_GRANULARITY_S
    by_use = sorted(entries(root), key=lambda e: (e.used, e.path))
    total = sum(e.size for e in by_use)
    for entry in by_use:
        # The last use may lie in the future: the clock was set back.
        old = older_than_s is not None and now - entry.used > older_than_s
        large = max_bytes is not None and total > max_bytes
        goes = (old or large) and entry.used < since and (dry or _removed(entry))
        if goes:
            total -= entry.size
            result.removed += 1
            result.removed_bytes += entry.size
            result.paths.append(entry.path)
        else:
            result.kept += 1
            result.kept_bytes += entry.size
            result.in_use += old or large
    return result


def verify_cache(root: Path, *, remove: bool = False) -> tuple[int, list[tuple[Path, str]]]:
    """Compare every entry with its checksum; returns the number of entries, and the damaged ones with the problem."""
    _require_cache(root)
    damaged: list[tuple[Path, str]] = []
    count = 0
    for entry in entries(root):
        if entry.stage == files.DATASETS:
            continue  # they have hashes of their own, which `dancedata check` compares
        count += 1
        try:
            files.read_array(entry.path) if entry.path.suffix == ".npy" else files.read_json(entry.path)
        except FileNotFoundError:
            count -= 1
        except (OSError, ValueError) as error:
            damaged.append((entry.path, str(error)))
            if remove:
                entry.path.unlink(missing_ok=True)
    return count, sorted(damaged)


def parse_age(text: str) -> float:
    """Read "30d", "12h", "90m", "2w" or "45s", as seconds; a number without a unit is refused."""
    return _quantity(text, _AGE, _AGES, "age", "30d, 12h, 2w (units: s, m, h, d, w)")


def parse_size(text: str) -> int:
    """Read "50GB", "500M" or "0B", as bytes; units of 1000; a number without a unit is refused."""
    return int(_quantity(text, _SIZE, _UNITS, "size", "50GB, 500MB (units: B, kB, MB, GB, TB)"))


def _quantity(text: str, pattern: re.Pattern[str], units: Mapping[str, int], what: str, allowed: str) -> float:
    match = pattern.fullmatch(text.strip().lower())
    if match is None:
        allowed = f"a number with a unit, such as {allowed}"
        # 3 days, 3 hours or 3 seconds: a guess could empty the cache.
        problem = f"the {what} has no unit" if _NUMBER.fullmatch(text.strip()) else f"not a valid {what}"
        raise UsageError(problem, found=repr(text[:_SHOWN]), allowed=allowed, fix="nothing was removed")
    return float(match["number"]) * units[match["unit"][0]]


def oldest_running(root: Path) -> float:
    """Return when the oldest running build began, in seconds since 1970; infinity if none is running."""
    begun = []
    for path in (root / files.LOCKS).glob(f"{files.RUNNING}{'[0-9a-f]' * 32}"):
        with suppress(FileNotFoundError):
            since = path.stat().st_mtime
            if not is_abandoned(path):
                begun.append(since)
    return min(begun, default=math.inf)


def remove_unused(path: Path, used: float) -> bool:
    """Remove an entry, unless it was used after `used` or a process has it mapped; return whether it is gone."""
    try:
        fd = open_file(path, os.O_RDWR)
    except FileNotFoundError:
        return True
    except PermissionError:
        fd = open_file(path, os.O_RDONLY)
    try:
        in_use = os.fstat(fd).st_mtime != used or lock_file(fd, wait=False) is False
    except BaseException:
        unlock(fd)
        raise
    if in_use:
        unlock(fd)
        return False
    with suppress(FileNotFoundError):
        remove_locked(path, fd)
    return True


def _removed(entry: Entry) -> bool:
    try:
        return remove_unused(entry.path, entry.modified)
    except OSError as error:
        raise StoreError("an entry of the cache cannot be removed", where=entry.path, found=str(error),
                         fix="the user who made it can prune it") from error  # fmt: skip


def _folders(folder: Path) -> Sequence[Path]:
    return sorted(Path(e.path) for e in _scanned(folder) if e.is_dir(follow_symlinks=False))


def _scanned(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as files_of:
            return list(files_of)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise StoreError("the cache cannot be read", where=folder, found=str(error)) from error

"""dancedata cache: what the cache holds, what to remove of it, and whether it is sound."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from stat import S_ISREG
from typing import Any

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.text import listed
from dancedata.execution import cache_files as files

_UNITS = {"b": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12}
_AGES = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_NUMBER = re.compile(r"(?P<number>[0-9]{1,15}(?:\.[0-9]{1,15})?)")
_AGE = re.compile(rf"{_NUMBER.pattern}\s*(?P<unit>[smhdw])")
_SIZE = re.compile(rf"{_NUMBER.pattern}\s*(?P<unit>b|[kmgt]b?)")
#: Characters of a wrong value that a message shows.
_SHOWN = 40


@dataclass(frozen=True)
class Entry:
    """A file of the cache.

    Attributes
    ----------
    size
        Bytes on disk, blocks counted in full.
    used
        Time of the last use, seconds since 1970; kept to the hour.
    """

    path: Path
    stage: str
    size: int
    used: float


@dataclass
class StageSum:
    """Sums over a stage: entries, bytes, and the times of use of the oldest and the newest."""

    entries: int = 0
    bytes: int = 0
    oldest: float | None = None
    newest: float | None = None

    def add(self, entry: Entry) -> None:
        """Count an entry."""
        self.entries += 1
        self.bytes += entry.size
        self.oldest = entry.used if self.oldest is None else min(self.oldest, entry.used)
        self.newest = entry.used if self.newest is None else max(self.newest, entry.used)


@dataclass
class Pruned:
    """What was removed, or would be, and what is left.

    Attributes
    ----------
    in_use
        Entries among those kept that would have gone, had not a build or a training job that is running used them.
    swept
        Files that killed processes left, removed as well.
    """

    removed: int = 0
    removed_bytes: int = 0
    kept: int = 0
    kept_bytes: int = 0
    in_use: int = 0
    swept: int = 0
    paths: list[Path] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {**self.__dict__, "paths": [str(path) for path in self.paths]}

    def describe(self, dry: bool) -> str:
        """Return what `cache prune` prints."""
        what = "would remove" if dry else "removed"
        swept = f"; removed {self.swept} files of killed processes" if self.swept else ""
        in_use = f", {self.in_use} of them because they are in use" if self.in_use else ""
        return (
            f"{what} {self.removed} entries, {size_text(self.removed_bytes)}; "
            f"{self.kept} are left, {size_text(self.kept_bytes)}{in_use}{swept}"
        )


def require_cache(root: Path) -> None:
    """Raise UsageError if a folder holds files and is not known as a cache."""
    if files.is_cache(root) or not any(names for _, _, names in os.walk(root)):
        return
    names = sorted(os.listdir(root))
    raise UsageError(
        "this folder is not a cache of dancedata; nothing was removed",
        where=root,
        found=listed(names),
        allowed=f"a folder with {files.MARKER} in it, which builds write",
        fix="name the cache's folder: --cache DIR, or $DANCEDATA_CACHE",
    )


def entries(root: Path) -> Iterator[Entry]:
    """List all entries of a cache; what vanishes meanwhile is passed over."""
    for stage in _folders(root):
        if stage.name not in files.STAGES:
            continue
        for prefix in _folders(stage):
            for found in _scanned(prefix):
                match = files.ENTRY.fullmatch(found.name)
                if match is None or match["two"] != prefix.name:
                    continue
                try:
                    stat = found.stat(follow_symlinks=False)
                except OSError:
                    continue
                if not S_ISREG(stat.st_mode):
                    continue
                size = max(stat.st_size, stat.st_blocks * 512)
                yield Entry(Path(found.path), stage.name, size, stat.st_mtime)


def cache_json(root: Path) -> dict[str, Any]:
    """Return what `cache info --json` prints: by stage entries, bytes, least and most days without a use."""
    require_cache(root)
    now = time.time()
    stages: dict[str, StageSum] = {}
    for entry in entries(root):
        stages.setdefault(entry.stage, StageSum()).add(entry)
    total = sum(s.bytes for s in stages.values())
    count = sum(s.entries for s in stages.values())
    about = {
        name: {
            "entries": s.entries,
            "bytes": s.bytes,
            "days_unused": [_days(now, s.newest), _days(now, s.oldest)],
        }
        for name, s in sorted(stages.items())
    }
    return {"path": str(root), "entries": count, "bytes": total, "stages": about}


def describe_cache(about: dict[str, Any]) -> str:
    """Return what `cache info` prints."""
    lines = [f"{about['path']}: {about['entries']} entries, {size_text(about['bytes'])}"]
    width = max((len(name) for name in about["stages"]), default=0)
    for name, stage in about["stages"].items():
        least, most = stage["days_unused"]
        lines.append(
            f"  {name.ljust(width)}  {stage['entries']:>8}  {size_text(stage['bytes']):>9}"
            f"  last used {least:g} to {most:g} days ago"
        )
    return "\n".join(lines)


def size_text(n_bytes: float) -> str:
    """Return a size with a unit of 1000."""
    for unit in ("B", "kB", "MB"):
        if n_bytes < 1000:
            return f"{n_bytes:.3g} {unit}"
        n_bytes /= 1000
    return f"{n_bytes:.4g} GB"


def prune(
    root: Path, *, older_than_s: float | None = None, max_bytes: int | None = None, dry: bool = False
) -> Pruned:
    """Remove entries by age and size, those used longest ago first, but none that is in use.

    In use is what a training job has mapped (`FeatureCache`), and what was used since the oldest of the builds
    began that are running now.

    Parameters
    ----------
    older_than_s
        Remove what was not used for so many seconds.
    max_bytes
        Then remove what was used longest ago, until the rest is within so many bytes.
    dry
        Only say what would be removed.
    """
    if older_than_s is None and max_bytes is None:
        raise UsageError("nothing says what to remove", fix="give --older-than 30d, --max-size 50GB, or both")
    require_cache(root)
    now = time.time()
    result = Pruned(swept=0 if dry else files.sweep(root))
    begun = files.oldest_running(root)
    # The time of a use is kept to the hour.
    since = math.inf if begun is None else begun - files.USE_GRANULARITY_S
    found = sorted(entries(root), key=lambda e: (e.used, e.path))
    total = sum(e.size for e in found)
    for entry in found:
        # A use that lies in the future (the clock was set back) is no age.
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
    """Compare every entry with its checksum; returns how many there are, and the damaged ones with what is wrong.

    Parameters
    ----------
    remove
        Remove damaged entries. They are computed again when they are wanted; a build finds them by itself.
    """
    require_cache(root)
    damaged: list[tuple[Path, str]] = []
    count = 0
    for entry in entries(root):
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
    found = pattern.fullmatch(text.strip().lower())
    if found is None:
        allowed = f"a number with a unit, such as {allowed}"
        # 3 days, 3 hours or 3 seconds: a guess could empty the cache.
        problem = f"the {what} has no unit" if _NUMBER.fullmatch(text.strip()) else f"not a valid {what}"
        raise UsageError(problem, found=repr(text[:_SHOWN]), allowed=allowed, fix="nothing was removed")
    return float(found["number"]) * units[found["unit"][0]]


def _removed(entry: Entry) -> bool:
    try:
        return files.remove_unused(entry.path, entry.used)
    except OSError as error:
        raise StoreError(
            "an entry of the cache cannot be removed",
            where=entry.path,
            found=str(error),
            fix="entries belong to who made them: their owner can prune them",
        ) from error


def _days(now: float, used: float | None) -> float | None:
    return None if used is None else round(max(0.0, now - used) / 86400, 2)


def _folders(folder: Path) -> Sequence[Path]:
    return sorted(Path(e.path) for e in _scanned(folder) if e.is_dir(follow_symlinks=False))


def _scanned(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as found:
            return list(found)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise StoreError("the cache cannot be read", where=folder, found=str(error)) from error

"""dancedata cache: what the cache holds, and how it shrinks."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dancedata.cli.command import Output, command
from dancedata.core.errors import UsageError
from dancedata.core.text import counted, size_text

if TYPE_CHECKING:
    from dancedata.execution.cache_admin import Pruned

#: Options of each action.
_TAKES: dict[str, tuple[str, ...]] = {
    "": (), "prune": ("--older-than", "--max-size", "--dry-run"), "verify": ("--remove",),
}  # fmt: skip


@command(
    "cache",
    action="ACTION: prune removes entries, verify compares them with their checksums; default: what it holds.",
    older_than="AGE: Prune entries not used for this long: 30d, 12h.",
    max_size="SIZE: Prune the least recently used, down to this size: 50GB.",
    dry_run="Only print what prune would remove.",
    remove="Let verify remove damaged entries.",
)
def cache(
    action: str = "", *, older_than: str | None = None, max_size: str | None = None, dry_run: bool = False,
    remove: bool = False, cache: Path | None,
) -> Output:  # fmt: skip
    """See, shrink or verify the cache.

      dancedata cache
      dancedata cache prune --older-than 30d --max-size 50GB

    Entries in use stay. Exit code 1 if verify finds a damaged one.
    """
    from dancedata.execution import cache_admin
    from dancedata.execution.cache import Cache

    root = Cache.at(cache).root
    options = {"--older-than": older_than, "--max-size": max_size, "--dry-run": dry_run, "--remove": remove}
    if action not in _TAKES:
        raise UsageError("unknown action", found=action, allowed="prune, verify, or none")
    if stray := [name for name, value in options.items() if value and name not in _TAKES[action]]:
        fix = "dancedata cache verify --remove, dancedata cache prune --older-than AGE"
        problem = f"not an option of dancedata cache{f' {action}' if action else ''}: {', '.join(stray)}"
        raise UsageError(problem, fix=fix)
    if action == "prune":
        age = None if older_than is None else cache_admin.parse_age(older_than)
        size = None if max_size is None else cache_admin.parse_size(max_size)
        pruned = cache_admin.prune(root, older_than_s=age, max_bytes=size, dry=dry_run)
        return Output(pruned.to_json, lambda: describe_pruned(pruned, dry=dry_run))
    if action == "verify":
        count, damaged = cache_admin.verify_cache(root, remove=remove)
        listed = [{"path": str(path), "problem": problem} for path, problem in damaged]
        lines = [f"{'removed' if remove else 'damaged'}: {path}: {problem}" for path, problem in damaged]
        return Output(
            lambda: {"path": str(root), "entries": count, "removed": remove, "damaged": listed},
            lambda: "\n".join([*lines, f"{root}: {_entries(count)}, {len(damaged)} damaged"]),
            ok=not damaged,
        )
    about = cache_admin.cache_json(root)
    return Output(lambda: about, lambda: _describe_cache(about))


def _entries(n: int) -> str:
    return f"{n:,} {'entry' if n == 1 else 'entries'}"


def _describe_cache(about: dict[str, Any]) -> str:
    lines = [f"{about['path']}: {_entries(about['entries'])}, {size_text(about['bytes'])}"]
    width = max((len(name) for name in about["stages"]), default=0)
    for name, stage in about["stages"].items():
        least, most = stage["days_unused"]
        lines.append(
            f"  {name.ljust(width)}  {stage['entries']:>8}  {size_text(stage['bytes']):>9}"
            f"  last used {' to '.join(dict.fromkeys(map(age_text, (least, most))))} ago"
        )
    return "\n".join(lines)


def describe_pruned(pruned: "Pruned", *, dry: bool) -> str:
    """Return the text of `cache prune`."""
    verb = "would remove" if dry else "removed"
    swept = f"; removed {counted(pruned.swept, 'file')} of killed processes" if pruned.swept else ""
    in_use = f", {pruned.in_use} of them because they are in use" if pruned.in_use else ""
    return (
        f"{verb} {_entries(pruned.removed)}, {size_text(pruned.removed_bytes)}; "
        f"{pruned.kept} are left, {size_text(pruned.kept_bytes)}{in_use}{swept}"
    )


def age_text(days: float) -> str:
    """Return a time that has passed: "less than a minute", "15 minutes", "3 hours", "12 days"."""
    minutes = int(days * 24 * 60)
    if minutes < 1:
        return "less than a minute"
    units = ((24 * 60, "day"), (60, "hour"), (1, "minute"))
    # Two of a unit at least: 90 minutes, 36 hours.
    size, noun = next((size, noun) for size, noun in units if minutes >= 2 * size or size == 1)
    return counted(minutes // size, noun)

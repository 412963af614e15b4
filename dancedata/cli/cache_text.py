"""Text of `dancedata cache`."""

from typing import Any

from dancedata.core.text import size_text
from dancedata.execution.cache_admin import Pruned


def describe_cache(about: dict[str, Any]) -> str:
    """Return the text of `cache info`."""
    lines = [f"{about['path']}: {about['entries']} entries, {size_text(about['bytes'])}"]
    width = max((len(name) for name in about["stages"]), default=0)
    for name, stage in about["stages"].items():
        least, most = stage["days_unused"]
        lines.append(
            f"  {name.ljust(width)}  {stage['entries']:>8}  {size_text(stage['bytes']):>9}"
            f"  last used {least:g} to {most:g} days ago"
        )
    return "\n".join(lines)


def describe_pruned(pruned: Pruned, *, dry: bool) -> str:
    """Return the text of `cache prune`."""
    verb = "would remove" if dry else "removed"
    swept = f"; removed {pruned.swept} files of killed processes" if pruned.swept else ""
    in_use = f", {pruned.in_use} of them because they are in use" if pruned.in_use else ""
    return (
        f"{verb} {pruned.removed} entries, {size_text(pruned.removed_bytes)}; "
        f"{pruned.kept} are left, {size_text(pruned.kept_bytes)}{in_use}{swept}"
    )

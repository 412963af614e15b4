"""dancedata cache: info, prune, verify."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dancedata.cli.options import AsJson, CacheFolder, errors_to_exit_codes, print_result
from dancedata.cli.terminal import say
from dancedata.core.text import age_text, counted, json_text, size_text

if TYPE_CHECKING:
    from dancedata.execution.cache_admin import Pruned

app = typer.Typer(help="What the cache holds: info, prune, verify.", no_args_is_help=True)


@app.command("info")
@errors_to_exit_codes
def info(cache: CacheFolder = None, as_json: AsJson = False) -> None:
    """Show how much the cache holds, by stage."""
    from dancedata.execution.cache_admin import cache_json

    about = cache_json(_cache_root(cache))
    print_result(as_json, lambda: about, lambda: _describe_cache(about))


@app.command("prune")
@errors_to_exit_codes
def prune(
    older_than: Annotated[str | None, typer.Option(help="Remove entries not used for this long: 30d, 12h.")] = None,
    max_size: Annotated[
        str | None, typer.Option(help="Then remove the least recently used entries down to this size: 50GB.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only print what would be removed.")] = False,
    cache: CacheFolder = None,
    as_json: AsJson = False,
) -> None:
    """Remove entries by age and size, those used longest ago first."""
    from dancedata.execution.cache_admin import parse_age, parse_size
    from dancedata.execution.cache_admin import prune as run_prune

    age = None if older_than is None else parse_age(older_than)
    size = None if max_size is None else parse_size(max_size)
    result = run_prune(_cache_root(cache), older_than_s=age, max_bytes=size, dry=dry_run)
    print_result(as_json, result.to_json, lambda: describe_pruned(result, dry=dry_run))


@app.command("verify")
@errors_to_exit_codes
def verify(
    remove: Annotated[bool, typer.Option("--remove", help="Remove damaged entries.")] = False,
    cache: CacheFolder = None,
    as_json: AsJson = False,
) -> None:
    """Compare every entry with its checksum; exit code 1 if one is damaged."""
    from dancedata.execution.cache_admin import verify_cache

    root = _cache_root(cache)
    count, damaged = verify_cache(root, remove=remove)
    if as_json:
        listed = [{"path": str(path), "problem": problem} for path, problem in damaged]
        typer.echo(
            json_text({"path": str(root), "entries": count, "ok": not damaged, "removed": remove, "damaged": listed})
        )
    else:
        for path, problem in damaged:
            say(f"{'removed' if remove else 'damaged'}: {path}: {problem}")
        say(f"{root}: {_entries(count)}, {len(damaged)} damaged")
    if damaged:
        raise typer.Exit(1)


def _cache_root(cache: Path | None) -> Path:
    from dancedata.execution.cache import default_cache

    return (cache or default_cache()).absolute()


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

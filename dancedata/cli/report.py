"""dancedata report."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.errors import errors_to_exit_codes
from dancedata.core.text import json_text

TO_HELP = "HTML file to write; default NAME-report.html in the current folder, none with --json alone."
CLIPS_HELP = "Clips that the page plays: the most suspicious and others; above 12 in a folder beside the page."
SHARE_HELP = "State that you may share the music although the dataset's licence forbids it."


@errors_to_exit_codes
def report(
    store: Annotated[Path, typer.Argument(metavar="OUT", help="A built dataset.")],
    to: Annotated[Path | None, typer.Option(metavar="FILE.html", help=TO_HELP)] = None,
    clips: Annotated[str, typer.Option(metavar="N|all|none", help=CLIPS_HELP)] = "12",
    audio: Annotated[str, typer.Option(help="none, or embed: the music of the clips inside the page.")] = "none",
    source: Annotated[Path | None, typer.Option(help="Folder with the music, for --audio embed.")] = None,
    may_share: Annotated[bool, typer.Option("--i-may-share-this-music", help=SHARE_HELP)] = False,
    against: Annotated[Path | None, typer.Option(metavar="OTHER", help="Another built dataset beside it.")] = None,
    max_mb: Annotated[float, typer.Option(min=0, help="Largest page, megabytes.")] = 20,
    overwrite: Annotated[bool, typer.Option(help="Replace a file that is there.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print every number of the page as JSON.")] = False,
) -> None:
    """Write a page that shows what a dataset holds: dancedata report OUT --to FILE.html."""
    from dancedata.report.document import findings
    from dancedata.report.write import default_path, write_report

    target = to if to is not None or as_json else default_path(store)
    chosen: Any = int(clips) if clips.isdecimal() else clips  # checked there, as the next one
    how: Any = audio
    written = write_report(
        store, target, clips=chosen, audio=how, source=source, may_share=may_share, against=against, max_mb=max_mb,
        overwrite=overwrite,
    )  # fmt: skip
    if as_json:
        typer.echo(json_text(written.to_json()))
        return
    if written.path is not None:
        typer.echo(f"{written.path}: {written.path.stat().st_size / 1e6:.1f} MB")
    for finding in findings(written.numbers):
        typer.echo(f"  {finding.kind}: {finding.text}")

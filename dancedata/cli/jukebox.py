"""dancedata jukebox: getting the weights, and converting them."""

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from dancedata.cli.errors import errors_to_exit_codes
from dancedata.cli.options import AsJson

app = typer.Typer(help="Jukebox's weights: fetch, convert.", no_args_is_help=True)

#: Seconds between two lines of progress.
_INTERVAL_S = 5.0


@app.command()
@errors_to_exit_codes
def fetch(
    out: Annotated[Path, typer.Option(help="Folder to write vqvae.pth.tar and prior_level_2.pth.tar to.")],
    source: Annotated[
        str | None, typer.Option("--from", metavar="URL|DIR", help="A mirror or a local folder; default OpenAI's.")
    ] = None,
    accept_licence: Annotated[
        bool, typer.Option("--accept-licence", help="You agree to the weights' terms.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Get OpenAI's files, 10.3 GB: resumes interrupted downloads, checks size and hash. Shows the licence first."""
    from dancedata.audio.jukebox import fetch as run_fetch
    from dancedata.audio.jukebox.weights.download import OPENAI_URL

    def agreed(licence: str) -> bool:
        typer.echo(licence, err=True)
        return accept_licence or typer.confirm("Do you agree? (--accept-licence answers yes)", err=True)

    paths = run_fetch(out, source or OPENAI_URL, accept_licence=agreed, progress=_Lines())
    if as_json:
        typer.echo(json.dumps({"files": [str(path) for path in paths]}, indent=1))
    else:
        for path in paths:
            typer.echo(str(path))


@app.command()
@errors_to_exit_codes
def convert(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder that fetch wrote.")],
    out: Annotated[Path, typer.Option(help="Folder to write; safetensors files, 9.3 GB for layer 66.")],
    layer: Annotated[int, typer.Option(min=1, help="Only what this layer needs is kept.")] = 66,
    as_json: AsJson = False,
) -> None:
    """Convert the weights to safetensors: quicker to load, and smaller to move to a node without network."""
    from dancedata.audio.jukebox import convert as run_convert
    from dancedata.audio.jukebox.weights.folder import config_of

    converted = run_convert(folder, out, layer, config=config_of(folder))
    n_bytes = sum(size for size, _ in converted.files.values())
    if as_json:
        typer.echo(
            json.dumps(
                {"path": str(out), "layer": converted.layer, "bytes": n_bytes, "source": converted.source}, indent=1
            )
        )
    else:
        typer.echo(f"{out}: layer {converted.layer}, {len(converted.files)} files, {n_bytes / 1e9:.2f} GB")


class _Lines:
    """Prints how far a download is, a line every few seconds."""

    def __init__(self) -> None:
        self.last = 0.0

    def __call__(self, name: str, done: int, total: int | None) -> None:
        now = time.monotonic()
        if now - self.last < _INTERVAL_S and done != total:
            return
        self.last = now
        of = "" if total is None else f" of {total / 1e6:.0f}"
        typer.echo(f"{name}: {done / 1e6:.0f}{of} MB", err=True)

"""dancedata jukebox and dancedata hf: weights of networks, fetched and converted."""

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from dancedata.cli.options import AsJson, errors_to_exit_codes
from dancedata.core.text import printable

jukebox = typer.Typer(help="Jukebox's weights: fetch, convert.", no_args_is_help=True)
hf = typer.Typer(help="Models of the Hugging Face hub: fetch.", no_args_is_help=True)

#: Seconds between two lines of progress.
_INTERVAL_S = 5.0


@jukebox.command("fetch")
@errors_to_exit_codes
def fetch_jukebox(
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
    from dancedata.audio.jukebox import fetch
    from dancedata.audio.jukebox.weights.download import OPENAI_URL

    def agreed(licence: str) -> bool:
        typer.echo(licence, err=True)
        return accept_licence or typer.confirm("Do you agree? (--accept-licence answers yes)", err=True)

    paths = fetch(out, source or OPENAI_URL, accept_licence=agreed, progress=_Lines())
    if as_json:
        typer.echo(json.dumps({"files": [str(path) for path in paths]}, indent=1))
    else:
        for path in paths:
            typer.echo(str(path))


@jukebox.command()
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
    """Prints the progress of a download, a line every few seconds."""

    def __init__(self) -> None:
        self.last = 0.0

    def __call__(self, name: str, done: int, total: int | None) -> None:
        now = time.monotonic()
        if now - self.last < _INTERVAL_S and done != total:
            return
        self.last = now
        of = "" if total is None else f" of {total / 1e6:.0f}"
        typer.echo(f"{name}: {done / 1e6:.0f}{of} MB", err=True)


@hf.callback()
def _commands() -> None:
    """Models of the Hugging Face hub: fetch."""


@hf.command("fetch")
@errors_to_exit_codes
def fetch_hf(
    name: Annotated[str, typer.Argument(metavar="ID", help="The model's id on the hub, such as m-a-p/MERT-v1-95M.")],
    out: Annotated[Path, typer.Option(help="Folder to make; the recipe's audio.hf.NAME.model.")],
    revision: Annotated[
        str | None, typer.Option(metavar="SHA", help="Commit of the model; without it the error names the newest.")
    ] = None,
    pickles: Annotated[
        bool, typer.Option("--pickles", help="Fetch pickled weights if the repository has no safetensors.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Get a model's weights, configs and card at a commit, never its code. Shows and stores the weights' licence."""
    from dancedata.audio.hf.fetch import fetch_model

    model = fetch_model(
        name,
        revision,
        out,
        pickles=pickles,
        show_licence=lambda licence: typer.echo(f"{name}: licence of the weights: {licence}", err=True),
    )
    if as_json:
        typer.echo(json.dumps(model.to_json(), indent=1))
        return
    typer.echo(f"{model.path}: {model.id} at {model.revision}, {len(model.files)} files; licence: {model.licence}")
    if model.left_out:
        typer.echo(f"left out: {', '.join(map(printable, model.left_out))}")

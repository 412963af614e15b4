"""dancedata hf: getting models from the Hugging Face hub."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dancedata.cli.errors import errors_to_exit_codes
from dancedata.cli.options import AsJson
from dancedata.core.text import printable

app = typer.Typer(help="Models of the Hugging Face hub: fetch.", no_args_is_help=True)


@app.callback()
def _commands() -> None:
    """Models of the Hugging Face hub: fetch."""


@app.command()
@errors_to_exit_codes
def fetch(
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

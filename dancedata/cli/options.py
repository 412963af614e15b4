"""Shared parts of commands: options, each written once with its type and help; output; errors as exit codes."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.interrupts import Interrupted, is_interrupted
from dancedata.cli.terminal import say
from dancedata.core.errors import DanceDataError, UsageError, unwritable_name
from dancedata.core.text import json_text
from dancedata.execution.arithmetic import adopt

RecipeName = Annotated[
    str, typer.Argument(metavar="RECIPE", help="A recipe's name (see list), a YAML file, or an address.")
]
Source = Annotated[Path | None, typer.Option(help="Folder with the dataset's files; demo makes its own.")]
Out = Annotated[Path | None, typer.Option(help="Folder to write; default data/RECIPE.")]
JOBS_HELP = "Worker processes; the result does not depend on it."
Jobs = Annotated[int, typer.Option(min=1, help=JOBS_HELP)]
JobsOrCores = Annotated[int | None, typer.Option(min=1, help=f"{JOBS_HELP} Default: one per core.")]
Set = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the recipe.")]
PLUGIN_HELP = "Python file with plug-ins; it is executed. May be given several times."
Plugins = Annotated[list[Path] | None, typer.Option("--plugin", metavar="FILE", help=PLUGIN_HELP)]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress.")]
CACHE_HELP = "Cache folder; default $DANCEDATA_CACHE, else the user's cache folder."
CacheFolder = Annotated[Path | None, typer.Option("--cache", help=CACHE_HELP)]
BACKEND_HELP = "loky (processes of this machine), dask or ray; default: that of --scheduler, else loky."
Backend = Annotated[str | None, typer.Option(help=BACKEND_HELP)]
SCHEDULER_HELP = "Cluster: tcp://HOST:PORT (Dask), ray://HOST:PORT or ray://auto."
Scheduler = Annotated[str | None, typer.Option(metavar="ADDRESS", help=SCHEDULER_HELP)]
NORMALIZED_HELP = "Whether columns are normalised by the dataset's scaler; must be stated, here or in their files."
SCALER_HELP = "File of scaler.save(...): the scaler that normalises the columns, instead of the dataset's."
CLIP_HELP = "Cut normalised values to [-1, 1] first, as EDGE and Lodge do."
Normalized = Annotated[
    bool | None, typer.Option("--normalized/--not-normalized", help=NORMALIZED_HELP, show_default=False)
]
ScalerFile = Annotated[Path | None, typer.Option("--scaler", metavar="FILE", help=SCALER_HELP)]
BODY_MODEL_HELP = "Your file of SMPL, SMPL-H or SMPL-X (.npz, .pkl): its mesh is drawn, or written."
BodyModel = Annotated[Path | None, typer.Option("--body-model", metavar="FILE", help=BODY_MODEL_HELP)]
BETAS_HELP = "Shape of the body model: numbers with commas, such as 0.5,-1.2; default: its mean."
Betas = Annotated[str | None, typer.Option("--betas", metavar="B,...", help=BETAS_HELP)]
Clip = Annotated[bool, typer.Option("--clip-values", help=CLIP_HELP)]


def print_result(as_json: bool, document: Callable[[], Any], text: Callable[[], str]) -> None:
    """Print a result as JSON or as text."""
    if as_json:
        typer.echo(json_text(document()))
    else:
        say(text())


def betas_of(text: str | None) -> tuple[float, ...] | None:
    """Return the numbers of --betas."""
    try:
        return None if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError("invalid value for --betas", found=text, allowed="numbers with commas: 0.5,-1.2") from None


def errors_to_exit_codes(command: Callable[..., None]) -> Callable[..., None]:
    """Print dancedata's errors as text; exit with code 2 for wrong usage, 1 for a problem in the data.

    Before a command begins, and loads numpy, the instructions are chosen that results are computed with.
    """

    @wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            adopt()
            command(*args, **kwargs)
        except (DanceDataError, UnicodeEncodeError) as error:
            if is_interrupted():
                raise Interrupted from None
            failure = unwritable_name(error) if isinstance(error, UnicodeEncodeError) else error
            say(f"error: {failure}", err=True)
            raise typer.Exit(2 if isinstance(failure, UsageError) else 1) from None

    return run

"""The command line. Heavy imports happen inside the commands, so that --help answers at once."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.version import __version__

app = typer.Typer(
    help="Turn dance motion capture and music into training data.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

RecipeName = Annotated[str, typer.Argument(metavar="RECIPE", help="A recipe's name (see list) or a YAML file.")]
Source = Annotated[Path | None, typer.Option(help="Folder with the dataset's files; demo makes its own.")]
Out = Annotated[Path | None, typer.Option(help="Folder to write; default data/RECIPE.")]
JOBS_HELP = "Worker processes; the result does not depend on it."
Jobs = Annotated[int, typer.Option(min=1, help=JOBS_HELP)]
Set = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the recipe.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress.")]
CACHE_HELP = "Cache folder; default $DANCEDATA_CACHE, else the user's cache folder."


def _errors_to_exit_codes(command: Callable[..., None]) -> Callable[..., None]:
    """Print our errors as text: exit code 2 for wrong usage, 1 for a problem in the data."""

    @wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except DanceDataError as error:
            typer.echo(f"error: {error}", err=True)
            raise typer.Exit(2 if isinstance(error, UsageError) else 1) from None
        except KeyboardInterrupt:
            typer.echo("interrupted; the same command goes on where it was", err=True)
            raise typer.Exit(130) from None

    return run


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        typer.echo(f"dancedata {__version__}")
        raise typer.Exit


@app.command()
@_errors_to_exit_codes
def build(
    recipe: RecipeName,
    source: Source = None,
    out: Out = None,
    jobs: Annotated[int | None, typer.Option(min=1, help=f"{JOBS_HELP} Default: one a core.")] = None,
    overrides: Set = None,
    overwrite: Annotated[bool, typer.Option(help="Replace a dataset made by another recipe or source.")] = False,
    strict: Annotated[bool, typer.Option(help="Stop at a broken clip instead of setting it aside.")] = False,
    cache: Annotated[Path | None, typer.Option(help=CACHE_HELP)] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Build a dataset: dancedata build aist++ --source DIR --out DIR."""
    from joblib import cpu_count

    from dancedata.pipeline.build import build as run_build
    from dancedata.pipeline.execute import Progress
    from dancedata.pipeline.recipe import load_recipe
    from dancedata.pipeline.report import describe_store, store_json

    made = load_recipe(recipe, overrides or ())
    target = out or Path("data") / made.name
    progress = Progress(quiet=quiet or as_json)
    folder = _source_of(made, source, target)
    progress.say(f"building {made.name} from {folder} into {target}")
    result = run_build(
        made,
        folder,
        target,
        jobs=jobs or cpu_count(),
        overwrite=overwrite,
        strict=strict,
        cache=cache,
        progress=progress,
    )
    if as_json:
        _print_json({"built": result.built, **store_json(target)})
        return
    if result.built:
        for note in result.scan_notes:
            typer.echo(f"note: {note}")
    else:
        typer.echo("nothing to do: this dataset is there already, from the same recipe and source")
    typer.echo(describe_store(target))


@app.command()
@_errors_to_exit_codes
def plan(
    recipe: RecipeName,
    source: Source = None,
    out: Out = None,
    jobs: Jobs = 1,
    overrides: Set = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Show what a build would make; reads lengths only and writes nothing under OUT."""
    from dancedata.pipeline.execute import Progress
    from dancedata.pipeline.plan import make_plan
    from dancedata.pipeline.recipe import load_recipe
    from dancedata.pipeline.report import describe_plan

    made = load_recipe(recipe, overrides or ())
    target = out or Path("data") / made.name
    progress = Progress(quiet=quiet or as_json)
    folder = _source_of(made, source, target)
    if not folder.exists() and getattr(made.dataset, "generates", False):
        progress.say(f"the dataset {made.dataset.name} writes its own source: {folder}")
    found = make_plan(made, folder, jobs=jobs, progress=progress)
    if as_json:
        _print_json(found.to_json())
    else:
        typer.echo(describe_plan(found, target))


@app.command()
@_errors_to_exit_codes
def check(
    path: Annotated[Path, typer.Argument(help="A built dataset, or a folder to build from.")],
    dataset: Annotated[str | None, typer.Option(help="Reader of a source folder; default: found by itself.")] = None,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Check a built dataset or a source folder; exit code 1 if something is wrong."""
    from dancedata.pipeline.check import check as run_check
    from dancedata.pipeline.execute import Progress
    from dancedata.pipeline.report import describe_problems

    problems = run_check(path, dataset=dataset, jobs=jobs, progress=Progress(quiet=quiet or as_json))
    errors = [p for p in problems if p.severity == "error"]
    if as_json:
        _print_json({"path": str(path), "ok": not errors, "problems": [p.to_json() for p in problems]})
    else:
        typer.echo(describe_problems(path, problems))
    if errors:
        raise typer.Exit(1)


@app.command()
@_errors_to_exit_codes
def info(
    path: Annotated[Path, typer.Argument(help="A built dataset.")],
    clips: Annotated[bool, typer.Option(help="List every clip with its windows and quality flags.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show what a built dataset holds."""
    from dancedata.pipeline.report import describe_clips, describe_store, store_json

    if as_json:
        _print_json(store_json(path))
        return
    typer.echo(describe_store(path))
    if clips:
        typer.echo(describe_clips(path))


@app.command("list")
@_errors_to_exit_codes
def list_plugins(as_json: AsJson = False) -> None:
    """List recipes, datasets, representations, contact rules and audio features, with their keys."""
    from dancedata.pipeline.report import catalogue, describe_catalogue

    if as_json:
        _print_json(catalogue())
    else:
        typer.echo(describe_catalogue(catalogue()))


@app.command()
@_errors_to_exit_codes
def features(
    songs: Annotated[list[Path], typer.Argument(metavar="SONG...", help="wav, flac, mp3 or ogg files.")],
    out: Annotated[Path, typer.Option(help="Folder to write <song>.<feature>.npy and .json to.")],
    feature: Annotated[str | None, typer.Option(help="Default: those of --like, else librosa35.")] = None,
    like: Annotated[str | None, typer.Option(help="A built dataset or recipe whose features to match.")] = None,
    bpm: Annotated[float | None, typer.Option(help="Tempo of the songs; default: estimated.")] = None,
    as_json: AsJson = False,
) -> None:
    """Compute features of your own music, exactly as in training."""
    from dancedata.pipeline.songs import find_like, write_features

    written = write_features(songs, out, find_like(feature, like), bpm)
    if as_json:
        _print_json(written)
        return
    for about in written:
        shape = " x ".join(str(n) for n in about["shape"])
        typer.echo(
            f"{out / about['file']}: {shape} {about['dtype']}, {about['fps']} a second, {about['scope']} scope"
        )


def _source_of(recipe: Any, source: Path | None, out: Path) -> Path:
    if source is not None:
        return source
    if getattr(recipe.dataset, "generates", False):
        return out.parent / f"{out.name}-source"
    raise UsageError(
        f"the dataset {recipe.dataset.name} needs a source",
        fix=f"say where its files are: dancedata build {recipe.name} --source DIR",
    )


def _print_json(obj: Any) -> None:
    typer.echo(json.dumps(obj, indent=1, ensure_ascii=False))


def main() -> None:
    """Run the command line."""
    app(prog_name="dancedata")


if __name__ == "__main__":
    main()

"""The command line. Heavy imports happen inside the commands, so that --help answers at once."""

import sys
import time
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.cache import app as cache
from dancedata.cli.captures import align, manifest, quality
from dancedata.cli.command_group import Commands
from dancedata.cli.evaluate import evaluate
from dancedata.cli.hubs import pull, push
from dancedata.cli.options import (
    AsJson,
    Backend,
    Betas,
    BodyModel,
    CacheFolder,
    Clip,
    Jobs,
    JobsOrCores,
    Normalized,
    Out,
    Plugins,
    Quiet,
    RecipeName,
    ScalerFile,
    Scheduler,
    Set,
    Source,
    betas_of,
    errors_to_exit_codes,
    print_result,
)  # fmt: skip
from dancedata.cli.pages import report, view
from dancedata.cli.study import study, study_results
from dancedata.cli.terminal import say
from dancedata.cli.weights import hf, jukebox
from dancedata.core.errors import UsageError
from dancedata.core.plugin_files import load_plugins
from dancedata.core.text import counted, json_text
from dancedata.core.version import __version__

app = typer.Typer(
    cls=Commands,
    help="Turn dance motion capture and music into training data.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

ATOL_HELP = "Floating-point values that differ by no more than this are the same; default: compared exactly."
KINDS_HELP = (
    "dataset, representation, contact-rule, feature, key-motion, augmentation, field, transform, annotator, rule, "
    "filter, metric or export."
)
PACKAGE_HELP = "Add it to the package OUT/PACKAGE, which may hold plug-ins of several kinds."
TARGET_HELP = "Set a parameter of the target; list shows them."
OUTPUT_HELP = "A trainer's output: .npy, .npz or .pkl files, folders of them, or patterns."
FRAMES_HELP = "Frames of --to obj, from 0; default: all."
WEIGHTS_HELP = "Folder of a network's weights; FIELD=FOLDER, once for each, where several features need some."
PART_HELP = "Compute the K-th of N shares of the work into the cache and write no dataset, for job arrays."


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        typer.echo(f"dancedata {__version__}")
        raise typer.Exit


@errors_to_exit_codes
def build(
    recipe: RecipeName,
    source: Source = None,
    out: Out = None,
    jobs: JobsOrCores = None,
    overrides: Set = None,
    overwrite: Annotated[bool, typer.Option(help="Replace a dataset made by another recipe or source.")] = False,
    strict: Annotated[bool, typer.Option(help="Stop at a broken clip instead of setting it aside.")] = False,
    cache: CacheFolder = None,
    backend: Backend = None,
    scheduler: Scheduler = None,
    part: Annotated[str | None, typer.Option(metavar="K/N", help=PART_HELP)] = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Build a dataset from motion and music.

    dancedata build aist++ --source DIR --out DIR. Of the address of a publication, the result is compared with it:
    exit code 1 if the bytes are others.
    """
    load_plugins(*(plugins or ()))
    from dancedata.building import commands
    from dancedata.building.describe import store_json

    options: dict[str, Any] = {
        "overrides": overrides or (), "jobs": jobs, "strict": strict, "cache": cache,
        "progress": not (quiet or as_json),
    }  # fmt: skip
    if part is not None:
        if backend not in (None, "loky") or scheduler is not None or overwrite:
            raise UsageError("--part goes with neither --backend, --scheduler nor --overwrite")
        share = commands.build_part(recipe, source, part, out=out, **options)
        print_result(as_json, share.to_json, lambda: str(share))
        return
    started = time.monotonic()
    result = commands.build(recipe, source, out, overwrite=overwrite, backend=backend, scheduler=scheduler, **options)
    if result.built and options["progress"]:
        say(f"built in {time.monotonic() - started:.1f} s", err=True)
    compared = {} if result.rebuilt is None else {"rebuilt": result.rebuilt}
    print_result(
        as_json, lambda: {"built": result.built, **store_json(result.path), **compared}, lambda: result.summary
    )
    if result.rebuilt is False:
        raise typer.Exit(1)


@errors_to_exit_codes
def plan(
    recipe: RecipeName,
    source: Source = None,
    out: Out = None,
    jobs: Jobs = 1,
    overrides: Set = None,
    cache: CacheFolder = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Show the dataset that a build would make.

    Reads lengths only and writes nothing under OUT.
    """
    load_plugins(*(plugins or ()))
    from dancedata.building import commands

    planned = commands.plan(
        recipe, source, out, overrides=overrides or (), jobs=jobs, cache=cache, progress=not (quiet or as_json)
    )
    if as_json:
        typer.echo(json_text(planned.to_json()))
    planned.require_clips()
    if not as_json:
        say(planned.describe(out or Path("data") / planned.recipe.name))


@errors_to_exit_codes
def check(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="PATH...", help="A built dataset or a folder to build from; or datasets to compare."),
    ],
    dataset: Annotated[str | None, typer.Option(help="Reader of a source folder; default: found by itself.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Read a source folder as this recipe does.")] = None,
    overrides: Set = None,
    jobs: Jobs = 1,
    plugins: Plugins = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Check a built dataset or a source folder.

    Of several datasets, what they share. Exit code 1 if something is wrong.
    """
    load_plugins(*(plugins or ()))
    from dancedata.building import commands
    from dancedata.building.describe import describe_problems
    from dancedata.execution.addresses import path_text

    problems = commands.check(
        *paths, dataset=dataset, recipe=recipe, overrides=overrides or (), jobs=jobs,
        progress=not (quiet or as_json),
    )  # fmt: skip
    errors = [p for p in problems if p.severity == "error"]
    others = {"others": [path_text(path) for path in paths[1:]]} if paths[1:] else {}
    print_result(
        as_json,
        lambda: {"path": path_text(paths[0]), "ok": not errors, "problems": [p.to_json() for p in problems]} | others,
        lambda: describe_problems(" and ".join(map(path_text, paths)), problems),
    )
    if errors:
        raise typer.Exit(1)


AS_HELP = "What its columns are: edge151, ...; default: what save_samples wrote states."


@errors_to_exit_codes
def decode(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help=OUTPUT_HELP)],
    to: Annotated[str, typer.Option(help="bvh, npz, smpl (AMASS's arrays), smplx, glb or obj.")],
    out: Annotated[Path, typer.Option(help="Folder for the files.")],
    field: Annotated[str | None, typer.Option("--as", metavar="NAME", help=AS_HELP)] = None,
    like: Annotated[Path | None, typer.Option(metavar="STORE", help="The trainer's dataset: scaler, rate.")] = None,
    normalized: Normalized = None,
    scaler: ScalerFile = None,
    clamp: Clip = False,
    fps: Annotated[str | None, typer.Option(help="Frames per second; default: the dataset's.")] = None,
    key: Annotated[str | None, typer.Option(help="Array in a file with several.")] = None,
    body_model: BodyModel = None,
    betas: Betas = None,
    frames: Annotated[str | None, typer.Option(metavar="N|A:B:STEP", help=FRAMES_HELP)] = None,
    overwrite: Annotated[bool, typer.Option(help="Overwrite existing files.")] = False,
    plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Write generated motion as BVH, SMPL, npz or a mesh.

    dancedata decode FILE... --as edge151 --to bvh --out DIR
    """
    load_plugins(*(plugins or ()))
    from dancedata.decoding.decode import decode as run

    kind: Any = to  # checked there
    written = run(
        list(files), field, to=kind, out=out, like=like, fps=fps, key=key, overwrite=overwrite,
        normalized=normalized, scaler=scaler, clamp=clamp, body_model=body_model, betas=betas_of(betas),
        frames=frames,
    )  # fmt: skip
    paths = [str(path) for path in written]
    print_result(as_json, lambda: {"files": paths}, lambda: "\n".join(paths))


@errors_to_exit_codes
def export(
    store: Annotated[Path, typer.Argument(metavar="STORE", help="A built dataset.")],
    to: Annotated[str, typer.Option(metavar="TARGET", help="What to export to: edge, lodge, npz, ... (see list).")],
    out: Annotated[Path, typer.Option(help="Folder to write; new or empty.")],
    source: Annotated[Path | None, typer.Option(help="Folder with the music, for targets that write sound.")] = None,
    feature: Annotated[str | None, typer.Option(help="Audio feature to write, where the target takes one.")] = None,
    scaler: Annotated[str | None, typer.Option(help="train or all: what the target's scaler is fitted on.")] = None,
    keep_ignored: Annotated[bool, typer.Option("--keep-ignored", help="Keep clips of the ignore list.")] = False,
    link: Annotated[bool, typer.Option("--link", help="Hard links in place of files with equal bytes.")] = False,
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help=TARGET_HELP)] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace an export that was not changed.")] = False,
    plugins: Plugins = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Write a dataset as the files of another trainer.

    Or of a program: dancedata export STORE --to edge --out DIR
    """
    load_plugins(*(plugins or ()))
    from dancedata.exports.base.run import export as run_export
    from dancedata.recipes.parse import apply_override

    parameters: dict[str, Any] = {}
    for override in overrides or ():
        apply_override(parameters, override)
    named = {"feature": feature, "scaler": scaler, "keep_ignored": keep_ignored or None}
    parameters |= {key: value for key, value in named.items() if value is not None}
    result = run_export(
        store, to, out, source=source, link=link, overwrite=overwrite, progress=not (quiet or as_json), **parameters
    )
    print_result(as_json, result.to_json, lambda: result.summary)


@errors_to_exit_codes
def info(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A built dataset.")],
    clips: Annotated[bool, typer.Option(help="List every clip with its windows and quality flags.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show the contents of a built dataset."""
    from dancedata.building.describe import describe_clips, describe_store, store_json

    print_result(as_json, lambda: store_json(path), lambda: describe_store(path))
    if clips and not as_json:
        say(describe_clips(path))


@errors_to_exit_codes
def segments(
    path: Annotated[Path, typer.Argument(metavar="OUT", help="A built dataset.")],
    to: Annotated[Path | None, typer.Option(help="New .csv or .jsonl file for its segments.")] = None,
    set_file: Annotated[
        Path | None, typer.Option("--set", metavar="FILE", help="Replace the layers that a .csv or .jsonl file has.")
    ] = None,
    layer: Annotated[str | None, typer.Option(help="Only layers of this name.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show, write or replace captions, moves and events.

    These are the segments of a dataset.
    """
    from dancedata.segments.command import segments as run_segments

    result = run_segments(path, to=to, set_file=set_file, layer=layer)
    print_result(as_json, result.to_json, lambda: str(result))


@errors_to_exit_codes
def list_(as_json: AsJson = False) -> None:
    """List recipes and plug-ins, with their keys."""
    from dancedata.cli.plugins import catalogue, describe_catalogue

    print_result(as_json, catalogue, lambda: describe_catalogue(catalogue()))


@errors_to_exit_codes
def new(
    kind: Annotated[str, typer.Argument(metavar="KIND", help=KINDS_HELP)],
    name: Annotated[str, typer.Argument(metavar="NAME", help="Its name in recipes, and of its Python module.")],
    out: Annotated[Path, typer.Option(help="Folder to write NAME.py and test_NAME.py to.")] = Path(),
    package: Annotated[str, typer.Option(metavar="PACKAGE", help=PACKAGE_HELP)] = "",
    as_json: AsJson = False,
) -> None:
    """Write a plug-in and its test from a template.

    The test passes unchanged.
    """
    from dancedata.cli.plugins import write_plugin

    plugin = write_plugin(kind, name, out, package)
    print_result(as_json, plugin.to_json, lambda: str(plugin))


@errors_to_exit_codes
def features(
    songs: Annotated[
        list[Path], typer.Argument(metavar="SONG...", help="Music files, folders of them, or patterns.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to write <song>.<feature>.npy and .json to.")] = Path("features"),
    feature: Annotated[str | None, typer.Option(help="Default: those of --like, else librosa35.")] = None,
    like: Annotated[str | None, typer.Option(help="A built dataset or recipe whose features to match.")] = None,
    bpm: Annotated[float | None, typer.Option(help="Tempo; default: what --like states, else estimated.")] = None,
    weights: Annotated[list[str] | None, typer.Option(metavar="[FIELD=]FOLDER", help=WEIGHTS_HELP)] = None,
    plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Compute features of your own music, as in training."""
    from dancedata.songs import describe_features, find_jobs, write_features

    load_plugins(*(plugins or ()))
    written = write_features(songs, out, find_jobs(feature, like), bpm, weights or (), like=like)
    print_result(as_json, lambda: written, lambda: "\n".join(describe_features(out, record) for record in written))


@errors_to_exit_codes
def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A built dataset.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another.")],
    atol: Annotated[float | None, typer.Option(help=ATOL_HELP)] = None,
    as_json: AsJson = False,
) -> None:
    """Show the differences between two built datasets.

    Exit code 1 if there are some.
    """
    from dancedata.comparison import diff as run_diff

    compared = run_diff(a, b, atol=atol)
    differences = [d for d in compared if d.kind != "note"]
    listed = [d.to_json() for d in compared]
    same = "the same data" + (f" within {atol:g}" if atol is not None else "")
    print_result(
        as_json,
        lambda: {"a": str(a), "b": str(b), "atol": atol, "same": not differences, "differences": listed},
        lambda: "\n".join([*compared.lines(), counted(len(differences), "difference") if differences else same]),
    )
    if differences:
        raise typer.Exit(1)


@errors_to_exit_codes
def doctor(as_json: AsJson = False) -> None:
    """Check in half a minute that this installation works.

    Exit code 1 if something fails. Leaves nothing behind.
    """
    from dancedata.cli.doctor import run_doctor

    if not run_doctor(as_json=as_json):
        raise typer.Exit(1)


for panel, commands in {
    "Make a dataset": (manifest, build, plan, check, quality, align),
    "Look at it": (view, report, info, study, study_results),
    "Use it": (export, evaluate, decode),
    "The rest": (pull, push, segments, list_, new, features, diff, doctor),
}.items():
    for command in commands:
        text = "\n\n".join(" ".join(lines.split()) for lines in (command.__doc__ or "").split("\n\n"))
        name = command.__name__.strip("_").replace("_", "-")
        app.command(name, help=text, rich_help_panel=panel)(command)
for name, group in {"cache": cache, "jukebox": jukebox, "hf": hf}.items():
    app.add_typer(group, name=name, rich_help_panel="The rest")


def main() -> None:
    """Run the command line."""
    # A path need not be UTF-8, and results name it.
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    app(prog_name="dancedata")

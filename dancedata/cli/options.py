"""Options: how a command states its own, and those that several commands have, each written once."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.help import RARE, SAMPLES, print_help
from dancedata.core.errors import UsageError

#: A help text, after what stands for the value, such as "DIR: Write there."; flags have the text alone.
#: In a section of its own: a pair of its title and the text; of a shared option the title alone.
About = str | tuple[str, str]
_MUSIC = "PATH: A song, a folder of songs, or a CSV sample,song,start_s; default: the dataset's."
_RIGHTS = "TEXT: Why you may redistribute what the terms forbid; this text is published."
_JOBS = "N: Worker processes; default one per core."
_FIELD = "NAME: What the columns are: a field of the dataset, or a representation such as edge151."
#: Options of several commands: their type and what is said of them.
SHARED: dict[str, tuple[Any, About]] = {
    "like": (Path | None, (SAMPLES, "DATASET: The dataset that the model was trained on.")),
    "field": (str | None, (SAMPLES, _FIELD)),
    "normalized": (bool | None, (SAMPLES, "Whether the columns are normalised by the dataset's scaler.")),
    "scaler": (Path | None, (SAMPLES, "FILE: The scaler that normalises the columns, as scaler.save writes it.")),
    "clamp": (bool, (SAMPLES, "Cut normalised values to [-1, 1] first, as EDGE and Lodge do.")),
    "fps": (str | None, (SAMPLES, "N: Frames per second.")),
    "up": (str | None, (SAMPLES, "AXIS: The axis that points up: y or z.")),
    "unit": (str | None, (SAMPLES, "UNIT: m, cm, mm or inch.")),
    "body": (str | None, (SAMPLES, "NAME: The body of joint positions: smpl24, smplx24, ...")),
    "protocol": (str | None, "NAME: See dancedata info protocols; default dancedata."),
    "split": (str | None, "NAMES: Splits of the dataset: test, or val,test, or all."),
    "music": (Path | None, _MUSIC),
    "rights": (str | None, _RIGHTS),
    "overwrite": (bool, "Replace what is there."),
    "overrides": (list[str] | None, "KEY=VALUE: Set a key to another value; repeatable."),
    "jobs": (int | None, _JOBS),
    "body_model": (Path | None, (RARE, "FILE: Your SMPL, SMPL-H or SMPL-X file: its mesh is used.")),
    "betas": (str | None, (RARE, "B,...: Shape of the body model: numbers with commas, such as 0.5,-1.2.")),
    "cluster": (str | None, (RARE, "ADDRESS: Compute on a cluster: tcp://HOST:PORT (Dask), ray://HOST:PORT.")),
    "cache": (Path | None, (RARE, "DIR: Default: $DANCEDATA_CACHE, else your cache folder.")),
    "plugins": (list[Path] | None, (RARE, "FILE: A Python file with plug-ins. It is executed.")),
    "quiet": (bool, (RARE, "No progress.")),
    "as_json": (bool, (RARE, "Print one JSON document.")),
}
#: Names of options that do not follow from those of the parameters.
_NAMES = {
    "out": ("-o", "--out"), "jobs": ("-j", "--jobs"), "quiet": ("-q", "--quiet"), "overrides": ("--set",),
    "plugins": ("--plugin",), "as_json": ("--json",), "normalized": ("--normalized/--not-normalized",),
}  # fmt: skip
Summary = Annotated[
    bool, typer.Option("-h", is_eager=True, callback=print_help(full=False), expose_value=False, hidden=True)
]
WholeHelp = Annotated[
    bool, typer.Option("--help", is_eager=True, callback=print_help(full=True), expose_value=False, hidden=True)
]
#: Options of all commands that print help.
HELP = {"summary": Summary, "whole_help": WholeHelp}


def parameters_of(
    function: Callable[..., Any], shared: str, about: Mapping[str, About]
) -> Iterator[inspect.Parameter]:
    """Yield the arguments and options of a command for Typer: its own, those it shares, and those of all commands."""
    names = [*shared.split(), "as_json"]
    for own in inspect.signature(function).parameters.values():
        if own.name in (*names, "progress"):
            continue
        if own.kind is own.POSITIONAL_OR_KEYWORD:
            metavar, _, text = str(about[own.name]).partition(": ")
            yield own.replace(annotation=Annotated[own.annotation, typer.Argument(metavar=metavar, help=text)])
        elif own.kind is own.KEYWORD_ONLY:
            yield own.replace(annotation=_option(own.name, own.annotation, about[own.name]))
    taken = {name: _option(name, *SHARED[name], about.get(name)) for name in names}
    for name, annotation in {**taken, **HELP}.items():
        default = None if SHARED.get(name, (bool,))[0] is not bool else False
        yield inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _option(name: str, kind: Any, about: About, section: Any = None) -> Any:
    panel, text = (None, about) if isinstance(about, str) else about
    panel = section or panel
    metavar, text = (None, text) if kind in (bool, bool | None) else text.split(": ", 1)
    names = _NAMES.get(name, (f"--{name.replace('_', '-')}",))
    return Annotated[kind, typer.Option(*names, help=text, metavar=metavar, rich_help_panel=panel)]


def read_values(options: dict[str, Any]) -> dict[str, Any]:
    """Return options as functions of the package take them: progress for quiet, numbers for betas."""
    if "quiet" in options:
        options["progress"] = not options.pop("quiet")
    if "overrides" in options:
        options["overrides"] = options["overrides"] or ()
    if (betas := options.get("betas")) is not None:
        try:
            options["betas"] = tuple(float(part) for part in betas.split(","))
        except ValueError:
            raise UsageError(
                "invalid value for --betas", found=betas, allowed="numbers with commas: 0.5,-1.2"
            ) from None
    return options

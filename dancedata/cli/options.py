"""Options that several commands have, each written once with its type and its help."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.help import RARE, SAMPLES
from dancedata.core.errors import UsageError


def option(*names: str, help: str, metavar: str | None = None, panel: str | None = None, **more: Any) -> Any:
    """Return an option of a command; its name follows from the parameter's if none is given."""
    return typer.Option(*names, help=help, metavar=metavar, rich_help_panel=panel, **more)


# What is read
Like = Annotated[
    Path | None, option(help="The dataset that the model was trained on.", metavar="DATASET", panel=SAMPLES)
]
FIELD_HELP = "What the columns are: a field of the dataset, or a representation such as edge151."
Field = Annotated[str | None, option(help=FIELD_HELP, metavar="NAME", panel=SAMPLES)]
NORMALIZED_HELP = "Whether the columns are normalised by the dataset's scaler."
Normalized = Annotated[
    bool | None, option("--normalized/--not-normalized", help=NORMALIZED_HELP, panel=SAMPLES, show_default=False)
]
SCALER_HELP = "The scaler that normalises the columns, as scaler.save writes it."
Scaler = Annotated[Path | None, option(help=SCALER_HELP, metavar="FILE", panel=SAMPLES)]
CLAMP_HELP = "Cut normalised values to [-1, 1] first, as EDGE and Lodge do."
Clamp = Annotated[bool, option("--clamp", help=CLAMP_HELP, panel=SAMPLES)]
MUSIC_HELP = "A song, a folder of songs, or a CSV sample,song,start_s; default: the music of the dataset."
Music = Annotated[Path | None, option(help=MUSIC_HELP, metavar="PATH")]
Fps = Annotated[str | None, option(help="Frames per second.", metavar="N", panel=SAMPLES)]
Up = Annotated[str | None, option(help="The axis that points up: y or z.", metavar="AXIS", panel=SAMPLES)]
Unit = Annotated[str | None, option(help="m, cm, mm or inch.", metavar="UNIT", panel=SAMPLES)]
Body = Annotated[
    str | None, option(help="The body of joint positions: smpl24, smplx24, ...", metavar="NAME", panel=SAMPLES)
]
Split = Annotated[str | None, option(help="Splits of the dataset: test, or val,test, or all.", metavar="NAMES")]
BodyModel = Annotated[
    Path | None,
    option("--body-model", help="Your SMPL, SMPL-H or SMPL-X file: its mesh is used.", metavar="FILE", panel=RARE),
]
BETAS_HELP = "Shape of the body model: numbers with commas, such as 0.5,-1.2."
Betas = Annotated[str | None, option(help=BETAS_HELP, metavar="B,...", panel=RARE)]
Protocol = Annotated[str, option(help="See: dancedata info protocols.", metavar="NAME")]

# What is written
Overwrite = Annotated[bool, option("--overwrite", help="Replace what is there.")]
RIGHTS_HELP = "Why you may pass it on against its terms; the text is published."
Rights = Annotated[str | None, option(help=RIGHTS_HELP, metavar="TEXT")]

# How
Set = Annotated[list[str] | None, option("--set", help="Change a key; repeatable.", metavar="KEY=VALUE")]
JOBS_HELP = "Worker processes; default one per core. The result is the same for any number."
Jobs = Annotated[int | None, option("-j", "--jobs", help=JOBS_HELP, metavar="N", min=1)]
CLUSTER_HELP = "Compute on a cluster: tcp://HOST:PORT (Dask), ray://HOST:PORT."
Cluster = Annotated[str | None, option(help=CLUSTER_HELP, metavar="ADDRESS", panel=RARE)]
CACHE_HELP = "Default: $DANCEDATA_CACHE, else your cache folder."
CacheFolder = Annotated[Path | None, option("--cache", help=CACHE_HELP, metavar="DIR", panel=RARE)]
PLUGIN_HELP = "A Python file with plug-ins. It is executed."
Plugins = Annotated[list[Path] | None, option("--plugin", help=PLUGIN_HELP, metavar="FILE", panel=RARE)]
Quiet = Annotated[bool, option("-q", "--quiet", help="No progress.", panel=RARE)]


def betas_of(text: str | None) -> tuple[float, ...] | None:
    """Return the numbers of --betas."""
    try:
        return None if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError("invalid value for --betas", found=text, allowed="numbers with commas: 0.5,-1.2") from None

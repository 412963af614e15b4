"""dancedata evaluate."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.options import (
    AsJson,
    Backend,
    CacheFolder,
    Clip,
    JobsOrCores,
    Normalized,
    Plugins,
    Quiet,
    ScalerFile,
    Scheduler,
    errors_to_exit_codes,
    print_result,
)  # fmt: skip
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.plugin_files import load_plugins
from dancedata.core.text import csv_cell, json_text, shown

WHAT_HELP = "A built dataset, a folder of generated motion, or one file of it."
SOURCE_HELP = "With --self-test: folder of the dataset's own files."
MUSIC_HELP = "A song, a folder of songs, or a CSV file sample,song,start_s; default: those of the dataset."
FIELD_HELP = "What columns are: a motion field of the dataset or of --like, or a representation."
LIKE_HELP = "Dataset that the model was trained on: rate, columns, scaler, music, and by default the pool."
POOL_HELP = "Dataset, folder or --save-pool file to compare with; default: the dataset itself, or --like."
METRIC_HELP = "Compute only this: a metric, of the protocol or not, or a score such as fid_k; repeatable."
ROLE_HELP = "truth or generated; default: truth for datasets."


@errors_to_exit_codes
def evaluate(
    what: Annotated[Path | None, typer.Argument(metavar="WHAT", help=WHAT_HELP)] = None,
    protocol: Annotated[
        str | None, typer.Option(help="A protocol, or a YAML file of one; default dancedata.")
    ] = None,
    pool: Annotated[Path | None, typer.Option(help=POOL_HELP)] = None,
    save_pool: Annotated[Path | None, typer.Option(help="Write the pool's features to this .npz file.")] = None,
    split: Annotated[str | None, typer.Option(help="Splits: test, or val,test, or all; default test.")] = None,
    pool_split: Annotated[str | None, typer.Option(help="Splits of the pool; default the protocol's.")] = None,
    role: Annotated[str | None, typer.Option(help=ROLE_HELP)] = None,
    like: Annotated[Path | None, typer.Option(help=LIKE_HELP)] = None,
    field: Annotated[str | None, typer.Option(metavar="NAME", help=FIELD_HELP)] = None,
    normalized: Normalized = None,
    scaler: ScalerFile = None,
    clamp: Clip = False,
    fps: Annotated[str | None, typer.Option(help="Frame rate of files that do not state it.")] = None,
    up: Annotated[str | None, typer.Option(help="Up axis of files that do not state it: y or z.")] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of files that do not state it: m, cm, mm, inch.")] = None,
    body: Annotated[
        str | None, typer.Option(help="Body of joint positions: smpl24, smpl24-edge, smplx24, ...")
    ] = None,
    source: Annotated[Path | None, typer.Option(help=SOURCE_HELP)] = None,
    music: Annotated[Path | None, typer.Option(metavar="PATH", help=MUSIC_HELP)] = None,
    metric: Annotated[list[str] | None, typer.Option(metavar="NAME", help=METRIC_HELP)] = None,
    per_clip: Annotated[Path | None, typer.Option(help="Write the numbers of each piece to this CSV file.")] = None,
    table: Annotated[str | None, typer.Option(help="Print the scores as latex or markdown.")] = None,
    list_protocols: Annotated[bool, typer.Option("--list-protocols", help="List the protocols.")] = False,
    self_test: Annotated[bool, typer.Option("--self-test", help="Compare --source with published rows.")] = False,
    jobs: JobsOrCores = None,
    cache: CacheFolder = None,
    backend: Backend = None,
    scheduler: Scheduler = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Evaluate dances by a named protocol.

    dancedata evaluate WHAT --protocol NAME
    """
    load_plugins(*(plugins or ()))
    from dancedata.evaluation import run as evaluation
    from dancedata.evaluation.tables import TABLES

    if table is not None and table not in TABLES:
        raise UsageError("unknown table", found=shown(table), allowed=", ".join(TABLES))
    if table is not None and as_json:
        raise UsageError("--table and --json are two outputs", fix="leave one of them out")
    if list_protocols:
        _list(as_json)
        return
    progress = not (quiet or as_json)
    if self_test:
        if what is not None or source is None:
            raise UsageError("--self-test reads the files of a dataset", fix="name them: --self-test --source DIR")
        result = evaluation.self_test(source, protocol=protocol, jobs=jobs, cache=cache, progress=progress)
        print_result(as_json, result.to_json, lambda: str(result))
        return
    if what is None:
        raise UsageError("there is nothing to evaluate", fix="name a dataset or a folder: dancedata evaluate WHAT")
    if per_clip is not None:
        _check_rows(per_clip)
    chosen: Any = role
    report = evaluation.evaluate(
        what, protocol=protocol or "dancedata", pool=pool, split=split, pool_split=pool_split, role=chosen, like=like,
        field=field, normalized=normalized, scaler=scaler, clamp=clamp, fps=fps, up=up, unit=unit, body=body,
        music=music, metrics=metric or (), save_pool=save_pool, jobs=jobs, cache=cache, backend=backend,
        scheduler=scheduler, progress=progress,
    )  # fmt: skip
    if per_clip is not None:
        _write_rows(per_clip, report.per_clip)
    if as_json:
        typer.echo(json_text(report.to_json()))
    else:
        say(str(report)) if table is None else typer.echo(TABLES[table](report))


#: The first columns of a table of clips.
_HEAD = ("clip", "piece", "frames")


def _check_rows(path: Path) -> None:
    """Raise UsageError unless a table of clips can be written to `path`; only such a table is replaced."""
    if not path.exists():
        if not path.parent.is_dir():
            raise UsageError("the folder of the table does not exist", where=path, fix="make it")
        return
    head = b""
    if path.is_file():
        with open(path, "rb") as file:
            head = file.read(len(",".join(_HEAD)))
    if head not in (b"", ",".join(_HEAD).encode()) or not path.is_file():
        raise UsageError(
            "refusing to overwrite a file that is not a table of clips", where=path, fix="give another name"
        )


def _write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    from dancedata.core.errors import StoreError
    from dancedata.files.atomic import write_text

    names = list(dict.fromkeys((*_HEAD, *(name for row in rows for name in row))))
    lines = [names, *([row.get(name, "") for name in names] for row in rows)]
    text = "".join(map(_csv_line, lines))
    try:
        write_text(path, text)
    except OSError as error:
        raise StoreError("the table of clips cannot be written", where=path, found=str(error)) from error


def _csv_line(cells: Sequence[object]) -> str:
    text = io.StringIO()
    csv.writer(text).writerow(map(csv_cell, cells))  # its line terminator makes it quote \r and \n
    return text.getvalue().removesuffix("\r\n") + "\n"


def _list(as_json: bool) -> None:
    from dancedata.evaluation.protocol_text import describe_protocols, protocols_json

    print_result(as_json, protocols_json, describe_protocols)

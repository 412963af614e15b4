"""dancedata align: the offset between music and motion."""

from pathlib import Path
from typing import Annotated

import typer

from dancedata.cli.options import AsJson, CacheFolder, Jobs, Quiet, Set, errors_to_exit_codes, print_result

TEST_HELP = "An offset is unknown too if other songs of the source fit."


@errors_to_exit_codes
def align(
    source: Annotated[Path, typer.Argument(metavar="SRC", help="A folder to build from: motion and music.")],
    by: Annotated[str, typer.Option(help="recording, clip or song: what has one offset.")] = "recording",
    dataset: Annotated[str | None, typer.Option(help="Reader of the folder; default: found by itself.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Read the folder as this recipe does.")] = None,
    overrides: Set = None,
    window: Annotated[float, typer.Option(metavar="SECONDS", help="Largest offset that is searched.")] = 0.5,
    level: Annotated[float, typer.Option(help="Largest p of a known offset.")] = 0.02,
    test_songs: Annotated[bool, typer.Option("--test-songs", help=TEST_HELP)] = False,
    seed: Annotated[int, typer.Option(help="Of the draws.")] = 0,
    out: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="New file: a line for each clip.")] = None,
    jobs: Jobs = 1,
    cache: CacheFolder = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Estimate the offset between music and motion.

    dancedata align SRC: offset, width, p, or why it is unknown. Changes no file.
    """
    from dancedata.pipeline.align import align as run_align

    found = run_align(
        source, by=by, dataset=dataset, recipe=recipe, overrides=overrides or (), window_s=window, level=level,
        test_songs=test_songs, seed=seed, out=out, jobs=jobs, cache=cache, progress=not (quiet or as_json),
    )  # fmt: skip
    print_result(as_json, found.to_json, lambda: str(found))

"""dancedata quality: faults of motions."""

from pathlib import Path
from typing import Annotated

import typer

from dancedata.cli.options import AsJson, CacheFolder, Jobs, Quiet, Set, errors_to_exit_codes, print_result


@errors_to_exit_codes
def quality(
    path: Annotated[str, typer.Argument(metavar="PATH", help="A built dataset, or a folder to build from.")],
    dataset: Annotated[str | None, typer.Option(help="Reader of the folder; default: found by itself.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Read the folder as this recipe does, repaired.")] = None,
    overrides: Set = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="New file: a line for each span.")] = None,
    jobs: Jobs = 1,
    cache: CacheFolder = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Score the faults of motions.

    dancedata quality PATH: spikes, frozen spans, jitter, sliding, the floor, bones, joint limits, self-contact, sides
    and the up axis, and how many clips are above each limit. Changes no file.
    """
    from dancedata.pipeline.quality import quality as run_quality

    found = run_quality(
        path, dataset=dataset, recipe=recipe, overrides=overrides or (), out=out, jobs=jobs, cache=cache,
        progress=not (quiet or as_json),
    )  # fmt: skip
    print_result(as_json, found.to_json, lambda: str(found))

"""dancedata manifest, quality, align: captures before they are built."""

from pathlib import Path
from typing import Annotated

import typer

from dancedata.cli.options import AsJson, CacheFolder, Jobs, Quiet, Set, errors_to_exit_codes, print_result
from dancedata.core.text import json_text

TEST_HELP = "An offset is unknown too if other songs of the source fit."


@errors_to_exit_codes
def manifest(
    source: Annotated[Path, typer.Argument(metavar="SRC", help="A folder of motion files and music.")],
    as_json: AsJson = False,
) -> None:
    """Propose a manifest of your own motion and music.

    dancedata manifest SRC > manifest.csv: pairs by name or length, with the evidence. Guesses are marked; check them.
    """
    from dancedata.datasets.folder.propose import propose

    proposed = propose(source.expanduser())
    typer.echo(json_text(proposed.to_json()) if as_json else proposed.to_csv(), nl=as_json)


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
    from dancedata.curation.quality import quality as run_quality

    result = run_quality(
        path, dataset=dataset, recipe=recipe, overrides=overrides or (), out=out, jobs=jobs, cache=cache,
        progress=not (quiet or as_json),
    )  # fmt: skip
    print_result(as_json, result.to_json, lambda: str(result))


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
    from dancedata.alignment.align import align as run_align

    result = run_align(
        source, by=by, dataset=dataset, recipe=recipe, overrides=overrides or (), window_s=window, level=level,
        test_songs=test_songs, seed=seed, out=out, jobs=jobs, cache=cache, progress=not (quiet or as_json),
    )  # fmt: skip
    print_result(as_json, result.to_json, lambda: str(result))

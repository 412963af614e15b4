"""dancedata pull, push: datasets of hubs and buckets."""

from pathlib import Path
from typing import Annotated

import typer

from dancedata.cli.options import AsJson, CacheFolder, Quiet, errors_to_exit_codes, print_result

RECIPE_ONLY_HELP = "Publish what rebuilds the dataset from the user's own source, and no data."
RIGHTS_HELP = "State that you may pass the data on although a licence forbids it; the text is published."
BESIDE_HELP = "With --recipe-only: a file that a build needs, such as manifest.csv; may be given several times."


@errors_to_exit_codes
def pull(
    address: Annotated[str, typer.Argument(metavar="ADDRESS", help="hf://datasets/ORG/NAME@REVISION, s3://, ...")],
    split: Annotated[list[str] | None, typer.Option(help="Only this split; may be given several times.")] = None,
    cache: CacheFolder = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Fetch a dataset of a hub or bucket into the cache.

    dancedata pull hf://datasets/ORG/NAME@REVISION --split train
    """
    from dancedata.remote.pull import pull as run_pull

    pulled = run_pull(address, split or None, cache=cache, progress=not (quiet or as_json))
    print_result(as_json, pulled.to_json, lambda: str(pulled))


@errors_to_exit_codes
def push(
    store: Annotated[Path, typer.Argument(metavar="STORE", help="A built dataset.")],
    to: Annotated[str, typer.Argument(metavar="ADDRESS", help="hf://datasets/ORG/NAME")],
    private: Annotated[bool, typer.Option("--private", help="Only its owners read the repository.")] = False,
    gated: Annotated[
        bool, typer.Option("--gated", help="Users accept the source's terms before they read it.")
    ] = False,
    recipe_only: Annotated[bool, typer.Option("--recipe-only", help=RECIPE_ONLY_HELP)] = False,
    rights: Annotated[str | None, typer.Option(help=RIGHTS_HELP)] = None,
    tag: Annotated[str | None, typer.Option(help="Name of the tag; default: of the dataset's hash.")] = None,
    beside: Annotated[list[Path] | None, typer.Option(metavar="FILE", help=BESIDE_HELP)] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace files of others.")] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Publish a dataset, or its recipe, on a hub.

    dancedata push STORE hf://datasets/ORG/NAME --private
    """
    from dancedata.plot.card import card_pictures
    from dancedata.remote.push import push as run_push

    pushed = run_push(
        store, to, private=private, gated=gated, recipe_only=recipe_only, rights=rights, tag=tag, beside=beside or (),
        pictures=card_pictures, overwrite=overwrite, progress=not (quiet or as_json),
    )  # fmt: skip
    print_result(as_json, pushed.to_json, lambda: str(pushed))

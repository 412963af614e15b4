"""dancedata export, pull, push: a dataset for other trainers, from a hub, and onto one."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.command import Output, command
from dancedata.cli.options import CacheFolder, Overwrite, Plugins, Quiet, Rights, option
from dancedata.core.errors import UsageError

TARGET_HELP = "edge, lodge, npz, ...: dancedata info targets; or card (README.md) or segments (.csv, .jsonl)."
LINK_HELP = "Hard links in place of files with equal bytes."
SOURCE_MUSIC_HELP = "Folder with the songs; default: the source of the dataset."
SET_HELP = "Set a parameter of the target; repeatable."
PULL_HELP = "hf://datasets/ORG/NAME@REVISION, s3://..., hf://MODEL@SHA, jukebox, or a folder of its files."
RECIPE_ONLY_HELP = "Publish what rebuilds it from a user's own source, manifest.csv too, and no data."


@command
def export(
    path: Annotated[Path, typer.Argument(metavar="DATASET", help="A built dataset.")],
    to: Annotated[str, option(metavar="TARGET", help=TARGET_HELP)],
    out: Annotated[Path, option("-o", "--out", metavar="PATH", help="A new or empty folder, or a file.")],
    overrides: Annotated[list[str] | None, option("--set", metavar="KEY=VALUE", help=SET_HELP)] = None,
    music: Annotated[Path | None, option(metavar="DIR", help=SOURCE_MUSIC_HELP)] = None,
    link: Annotated[bool, option("--link", help=LINK_HELP)] = False,
    overwrite: Overwrite = False,
    plugins: Plugins = None,
    quiet: Quiet = False,
) -> Output:
    """Write a dataset as the files that another trainer reads.

      dancedata export data/aistpp --to edge -o edge
      dancedata export data/aistpp --to card -o README.md

    All that is missing is named at once; nothing is written then.
    """
    if to in ("card", "segments") and (overrides or music is not None or link):
        raise UsageError(f"--to {to} goes with --out and --overwrite alone", fix="leave the others out")
    if to == "card":
        from dancedata.plot.card import card_pictures
        from dancedata.remote.card import write_card

        card = write_card(path, out, pictures=card_pictures, overwrite=overwrite, progress=not quiet)
        return Output(lambda: {"path": str(card)}, lambda: f"{card}, and its pictures in {card.stem}_files")
    if to == "segments":
        from dancedata.segments.command import segments

        written = segments(path, to=out)
        return Output(written.to_json, lambda: str(written), warnings=written.notes)
    from dancedata.exports.base.run import export as run_export
    from dancedata.recipes.parse import apply_override

    parameters: dict[str, Any] = {}
    for override in overrides or ():
        apply_override(parameters, override)
    result = run_export(path, to, out, source=music, link=link, overwrite=overwrite, progress=not quiet, **parameters)
    return Output(result.to_json, lambda: result.summary)


@command
def pull(
    address: Annotated[str, typer.Argument(metavar="WHAT", help=PULL_HELP)],
    out: Annotated[
        Path | None, option("-o", "--out", metavar="DIR", help="Folder of weights; a dataset goes to the cache.")
    ] = None,
    split: Annotated[list[str] | None, option(metavar="NAME", help="Only this split; repeatable.")] = None,
    accept_licence: Annotated[bool, option("--accept-licence", help="You agree to the terms.")] = False,
    cache: CacheFolder = None,
    quiet: Quiet = False,
) -> Output:
    """Fetch a dataset, or the weights of a network.

    dancedata pull hf://datasets/ORG/NAME@REVISION --split train
    dancedata pull hf://m-a-p/MERT-v1-95M@SHA -o mert
    dancedata pull jukebox -o jukebox       (10.3 GB; resumes)
    """
    from dancedata.cli.weights import are_weights, pull_weights

    if are_weights(address, out):
        if out is None:
            raise UsageError("weights go to a folder", where=address, fix="name it: --out DIR")
        return pull_weights(address, out, accept_licence=accept_licence, quiet=quiet)
    if out is not None:
        raise UsageError(
            "a dataset is fetched into the cache", fix="leave --out away, or name the cache: --cache DIR"
        )
    from dancedata.remote.pull import pull as run_pull

    pulled = run_pull(address, split or None, cache=cache, progress=not quiet)
    return Output(pulled.to_json, lambda: str(pulled))


@command
def push(
    path: Annotated[Path, typer.Argument(metavar="DATASET", help="A built dataset.")],
    to: Annotated[str, typer.Argument(metavar="ADDRESS", help="hf://datasets/ORG/NAME")],
    private: Annotated[bool, option("--private", help="Only its owners read the repository.")] = False,
    gated: Annotated[bool, option("--gated", help="Users accept the source's terms first.")] = False,
    recipe_only: Annotated[bool, option("--recipe-only", help=RECIPE_ONLY_HELP)] = False,
    dry_run: Annotated[bool, option("--dry-run", help="Check terms and sizes; publish nothing.")] = False,
    rights: Rights = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> Output:
    """Publish a dataset, or its recipe.

    dancedata push data/mine hf://datasets/ORG/NAME --private
    dancedata push data/mine hf://datasets/ORG/NAME --recipe-only
    """
    from dancedata.plot.card import card_pictures
    from dancedata.remote.push import push as run_push

    pushed = run_push(
        path, to, private=private, gated=gated, recipe_only=recipe_only, dry_run=dry_run, rights=rights,
        pictures=card_pictures, overwrite=overwrite, progress=not quiet,
    )  # fmt: skip
    return Output(pushed.to_json, lambda: str(pushed))

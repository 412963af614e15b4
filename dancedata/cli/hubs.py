"""dancedata export, pull, push: a dataset for other trainers, from a hub, and onto one."""

from pathlib import Path
from typing import Any

from dancedata.cli.command import Output, command
from dancedata.core.errors import UsageError


@command(
    "overrides overwrite plugins quiet",
    path="DATASET: A built dataset.",
    to="TARGET: edge, lodge, npz, ...: dancedata info targets; or card (README.md) or segments (.csv, .jsonl).",
    out="PATH: A new or empty folder, or a file.",
    music="PATH: Folder with the songs; default: the source of the dataset.",
    link="Hard links in place of files with equal bytes.",
)
def export(
    path: Path, *, to: str, out: Path, music: Path | None = None, link: bool = False, overrides: list[str],
    overwrite: bool, progress: bool,
) -> Any:  # fmt: skip
    """Write a dataset as the files that another trainer reads.

      dancedata export data/aistpp --to edge -o edge
      dancedata export data/aistpp --to card -o README.md

    If anything is missing, all of it is named at once, and nothing is written.
    """
    if to in ("card", "segments") and (overrides or music is not None or link):
        raise UsageError(f"--to {to} takes no options but --out and --overwrite", fix="leave the others out")
    if to == "card":
        from dancedata.plot.card import card_pictures
        from dancedata.remote.card import write_card

        card = write_card(path, out, pictures=card_pictures, overwrite=overwrite, progress=progress)
        return Output(lambda: {"path": str(card)}, lambda: f"{card}, and its pictures in {card.stem}_files")
    if to == "segments":
        from dancedata.segments.command import segments

        written = segments(path, to=out)
        return Output(written.to_json, lambda: str(written), warnings=written.notes)
    from dancedata.exports.base.run import export as run_export
    from dancedata.recipes.overrides import apply_override

    parameters: dict[str, Any] = {}
    for override in overrides:
        apply_override(parameters, override)
    result = run_export(path, to, out, source=music, link=link, overwrite=overwrite, progress=progress, **parameters)
    return Output(result.to_json, lambda: result.summary)


@command(
    "cache quiet",
    address="WHAT: hf://datasets/ORG/NAME@REVISION, s3://..., hf://MODEL@SHA, jukebox, or a folder of its files.",
    out="DIR: Folder for weights; a dataset goes to the cache.",
    split="NAMES: Only these splits: train, or train,val.",
    accept_licence="You agree to the terms.",
)
def pull(
    address: str, *, out: Path | None = None, split: str | None = None, accept_licence: bool = False, **how: Any
) -> Any:
    """Fetch a dataset, or the weights of a network.

    dancedata pull hf://datasets/ORG/NAME@REVISION --split train
    dancedata pull hf://m-a-p/MERT-v1-95M@SHA -o mert
    dancedata pull jukebox -o jukebox       (10.3 GB; resumes)
    """
    from dancedata.cli.weights import are_weights, pull_weights

    if are_weights(address, out):
        if out is None:
            raise UsageError("weights go to a folder", where=address, fix="name it: --out DIR")
        return pull_weights(address, out, accept_licence=accept_licence, progress=how["progress"])
    if out is not None:
        raise UsageError("a dataset is fetched into the cache", fix="omit --out, or name the cache: --cache DIR")
    from dancedata.remote.pull import pull as run_pull

    return run_pull(address, None if split is None else [name.strip() for name in split.split(",")], **how)


@command(
    "rights overwrite quiet",
    path="DATASET: A built dataset.",
    to="ADDRESS: hf://datasets/ORG/NAME",
    private="Only its owners can read the repository.",
    gated="Users must accept the source's terms first.",
    recipe_only="Publish what rebuilds it from a user's own source, including manifest.csv, but no data.",
    dry_run="Check terms and sizes; publish nothing.",
)
def push(
    path: Path, to: str, *, private: bool = False, gated: bool = False, recipe_only: bool = False,
    dry_run: bool = False, **how: Any,
) -> Any:  # fmt: skip
    """Publish a dataset, or its recipe.

    dancedata push data/mine hf://datasets/ORG/NAME --private
    dancedata push data/mine hf://datasets/ORG/NAME --recipe-only
    """
    from dancedata.plot.card import card_pictures
    from dancedata.remote.push import push as run_push

    return run_push(
        path, to, private=private, gated=gated, recipe_only=recipe_only, dry_run=dry_run, pictures=card_pictures,
        **how,
    )  # fmt: skip

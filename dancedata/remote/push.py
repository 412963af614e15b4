"""dancedata push: a built dataset, or its recipe, on a hub."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.core.errors import UsageError
from dancedata.core.packages import require
from dancedata.core.registry import DATASETS
from dancedata.core.text import counted, size_text
from dancedata.files.addresses import is_address, require_whole
from dancedata.files.listing import MANIFESTS
from dancedata.formats.hub_head import HubPlace
from dancedata.kernel import Progress, Store, open_store
from dancedata.remote.address import Address, parse_address
from dancedata.remote.cached import is_offline
from dancedata.remote.card import Pictures
from dancedata.remote.contents import contents
from dancedata.remote.terms import require_permission, restrictions
from dancedata.remote.upload import HubUpload

#: Digits of a dataset's hash in the name of a tag.
_DIGITS = 12


@dataclass(frozen=True)
class Pushed:
    """Result of `push`: the address with the tag, and the commit, "" of a dry run."""

    address: str
    commit: str
    files: int
    bytes: int
    uploaded_bytes: int  # not there before
    recipe_only: bool  # whether the recipe is published without the data

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return dict(self.__dict__)

    def __str__(self) -> str:
        what = "recipe" if self.recipe_only else "dataset"
        use = f"dancedata build {self.address} SOURCE" if self.recipe_only else f"dancedata pull {self.address}"
        done = f"{size_text(self.uploaded_bytes)} uploaded, commit {self.commit}\n{use}"
        return (
            f"{self.address}: {what}, {counted(self.files, 'file')}, {size_text(self.bytes)}, "
            f"{done if self.commit else 'nothing is published'}"
        )


def push(
    store: str | Path,
    to: str,
    *,
    private: bool = False,
    gated: bool = False,
    recipe_only: bool = False,
    rights: str | None = None,
    beside: Sequence[str | Path] = (),
    pictures: Pictures | None = None,
    dry_run: bool = False,
    overwrite: bool = False,
    progress: bool = True,
) -> Pushed:
    """Publish a built dataset, as ``dancedata push`` does.

    An upload that was interrupted goes on with the same call. One commit has all files, so that a branch has all of a
    publication or nothing. The token is that of huggingface_hub.

    Parameters
    ----------
    store
        Folder that `build` wrote.
    to
        hf://datasets/ORG/NAME. A repository is created if it does not exist; ``@BRANCH`` names another branch than
        main.
    private, gated
        Only its owners read it; users accept the terms of the source before they read it.
    recipe_only
        Publish no row of the data: the recipe, the clips with splits and hashes of their sources, the scaler, the
        hashes of the dataset, and the source's manifest. `build` of the address makes the dataset from the user's own
        source.
    rights
        Statement by which you may pass the data on although a licence does not allow it. It is published.
    beside
        With `recipe_only`: further files that a build needs, such as a local plug-in.
    pictures
        Draws the pictures of the card: `dancedata.plot.card_pictures`. Default: there are none.
    dry_run
        Check the terms and the dataset, and publish nothing.
    overwrite
        Replace files of the same names that were not published by this function.

    Raises
    ------
    UsageError
        If a licence does not allow it and `rights` is None, naming the clause; for an address that is not valid or
        cannot be written, and if something else is there.
    StoreError
        If the dataset is damaged, or the server fails; no part of the upload is visible there.

    Examples
    --------
    >>> from dancedata.remote.push import push
    >>> pushed = push("data/demo", "hf://datasets/ORG/NAME", private=True)  # doctest: +SKIP
    >>> pushed.address  # doctest: +SKIP
    'hf://datasets/ORG/NAME@dataset-01ffe21d9289'
    """
    if not is_address(to) or (address := parse_address(to)).scheme != "hf":
        raise UsageError(
            "datasets are published on hubs", found=to, allowed="hf://datasets/ORG/NAME",
            fix="upload its folder to a bucket with the bucket's own tool, such as aws s3 sync",
        )  # fmt: skip
    _check_options(address, recipe_only, rights, beside)
    reporter = Progress(quiet=not progress)
    with open_store(store) as opened:
        if rights is None and not recipe_only:
            require_permission(opened, to=to)
        require_whole(opened.path)
        opened.require_intact()
        digits = opened.info["self_sha256"][:_DIGITS]
        name = f"{'recipe' if recipe_only else 'dataset'}-{digits}"
        read_at = address.at(name)
        overridden = tuple(map(str, restrictions(opened))) if rights is not None and not recipe_only else ()
        place = HubPlace(str(read_at), rights or "", overridden, gated, recipe_only)
        more = [*_manifests(opened), *(Path(path).expanduser() for path in beside)] if recipe_only else []
        files = contents(opened, place, list(dict.fromkeys(more)), pictures, reporter)
        total = sum(file.size for file in files)
        if dry_run:
            return Pushed(str(read_at), "", len(files), total, 0, recipe_only)
        reporter.announce(f"publishing {opened.path} at {address}")
        message = f"Publish {opened.info.get('name', 'dataset')} {digits} with dancedata"
        at, uploaded = HubUpload(address, name, private, gated, overwrite).run(files, message, reporter)
    return Pushed(str(read_at), at.revision, len(files), total, uploaded, recipe_only)


def _manifests(store: Store) -> list[Path]:
    """Return the list of clips that was written for the dataset's reader, where its source is on this machine."""
    source, name = store.source_folder, store.reader_name
    if source is None or name not in DATASETS.names() or not DATASETS.get(name).has_listing(source):
        return []
    return [source / manifest for manifest in MANIFESTS if (source / manifest).is_file()]


def _check_options(address: Address, recipe_only: bool, rights: str | None, beside: Sequence[str | Path]) -> None:
    require("remote", what="push")
    where = str(address)
    if is_offline():
        raise UsageError("HF_HUB_OFFLINE is set: nothing is uploaded", where=where)
    if address.is_pinned:
        raise UsageError("a commit does not change", where=where, fix="name a branch, or none")
    if rights is not None and not rights.strip():
        raise UsageError("rights is empty", allowed='a statement, such as "granted by the authors, 2026-03-01"')
    if beside and not recipe_only:
        raise UsageError("files are published beside a recipe alone", fix="add --recipe-only, or leave them out")

"""The files of a publication, and publication.json, which lists them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dancedata.core.errors import DanceDataError, StoreError, UsageError
from dancedata.core.hashing import json_sha256, sha256_bytes
from dancedata.core.version import __version__
from dancedata.files.atomic import dump_json, dump_lines
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import parse_json
from dancedata.formats.hub_head import HubPlace
from dancedata.kernel import DatasetFiles, Progress, Store
from dancedata.remote.card import Pictures
from dancedata.remote.card_text import card_text, plain_recipe

#: Folder of the card's pictures.
PICTURES = "README_files"
RECIPE_FILE, CLIPS_FILE = "recipe.yaml", "clips.jsonl"
#: Attributes of a clip that are part of its hash, see `building.source_record`.
_ABOUT = ("split", "music", "tempo_bpm", "genre", "dancer", "lists")
#: Largest file that is published beside a recipe, such as a manifest.
_MAX_BESIDE = 1 << 26


@dataclass(frozen=True)
class Upload:
    """A file to publish: on the disk, or its bytes."""

    name: str
    content: Path | bytes
    size: int
    sha256: str

    @classmethod
    def of_bytes(cls, name: str, data: bytes) -> Upload:
        """Return the upload of bytes."""
        return cls(name, data, len(data), sha256_bytes(data))


def changed(name: str) -> StoreError:
    """Return the error for a dataset that was replaced while it is published."""
    return StoreError("the dataset was changed while it was published", where=name,
                      fix="run the same command again once nothing writes to it")  # fmt: skip


def contents(
    store: Store, place: HubPlace, beside: Sequence[Path], pictures: Pictures | None, progress: Progress
) -> list[Upload]:
    """Return the files of a publication, with those `beside` a recipe; the last one makes it complete."""
    listing = DatasetFiles.of(store.info, f"{store.path}/{DatasetFiles.DATASET}")
    if place.recipe_only:
        files = [*_recipe(store), *_beside(beside)]
        more = {"dataset": dict(store.info)}
    else:
        files = [Upload(f.file, store.path / f.file, f.size, f.sha256) for f in listing.files()]
        more = {}
    publication = Upload.of_bytes(DatasetFiles.PUBLICATION, dump_json(_described(store, place, files, more)).encode())
    if publication.size > DatasetFiles.MAX_BYTES:
        raise UsageError("the dataset has too many files and clips for one publication", where=str(store.path),
                         found=f"{DatasetFiles.PUBLICATION} of {publication.size:,} bytes",
                         allowed=f"{DatasetFiles.MAX_BYTES:,}",
                         fix="publish its parts as datasets of their own")  # fmt: skip
    files += _card(store, place, pictures, progress)
    if place.recipe_only:
        return [*files, publication]
    description = read_regular(store.path / DatasetFiles.DATASET, DatasetFiles.MAX_BYTES)
    if parse_json(description.decode())["self_sha256"] != store.info["self_sha256"]:
        raise changed(DatasetFiles.DATASET)
    return [*files, publication, Upload.of_bytes(DatasetFiles.DATASET, description)]


def _described(store: Store, place: HubPlace, files: Sequence[Upload], more: Mapping[str, Any]) -> dict[str, Any]:
    document = {
        "publication": 1,
        "dancedata": __version__,
        "name": store.info.get("name", ""),
        "dataset_sha256": store.info["self_sha256"],
        "licence": store.info.get("licence", ""),
        "citation": store.info.get("citation", ""),
        **({"rights": place.rights, "overridden": list(place.overridden)} if place.rights else {}),
        "files": {file.name: {"size": file.size, "sha256": file.sha256} for file in files},
        "shards": [],
        **more,
    }
    return document | {"self_sha256": json_sha256(document)}


def _recipe(store: Store) -> Iterator[Upload]:
    """Yield the files that rebuild and describe a dataset without holding a row of it."""
    recipe = yaml.safe_dump(plain_recipe(store), sort_keys=False, allow_unicode=True, width=100)
    yield Upload.of_bytes(RECIPE_FILE, recipe.encode())
    yield Upload.of_bytes(CLIPS_FILE, dump_lines(list(_clips(store))).encode())
    for name in (DatasetFiles.STATS, DatasetFiles.REJECTS):
        entry = store.info["files"][name]
        yield Upload(name, store.path / name, entry["size"], entry["sha256"])


def _clips(store: Store) -> Iterator[dict[str, Any]]:
    for clip in store:
        if not clip.source:
            terms = store.licences[clip.licence].to_json() if clip.licence >= 0 else {}
            about = {name: getattr(clip, name) for name in _ABOUT}
            yield {"id": clip.id, **about, "lists": list(clip.lists), "made_of": clip.made_of, **terms}


def _beside(paths: Sequence[Path]) -> Iterator[Upload]:
    taken = {DatasetFiles.DATASET, DatasetFiles.PUBLICATION, DatasetFiles.CARD}
    taken |= {DatasetFiles.STATS, DatasetFiles.REJECTS, RECIPE_FILE, CLIPS_FILE}
    for path in paths:
        name = path.name
        if name in taken:
            raise UsageError("a publication has another file of this name", where=path, fix="rename it")
        taken.add(name)
        try:
            DatasetFiles.of({"files": {name: {"size": 0, "sha256": "0" * 64}}, "shards": []}, str(path))
        except DanceDataError:
            raise UsageError(
                "the name of this file cannot be published", where=path, allowed="letters, digits, and _ . + -"
            ) from None
        try:
            yield Upload.of_bytes(name, read_regular(path, _MAX_BESIDE))
        except OSError as error:
            raise UsageError("the file cannot be read", where=path, found=str(error)) from error


def _card(store: Store, place: HubPlace, pictures: Pictures | None, progress: Progress) -> list[Upload]:
    drawn: Mapping[str, tuple[str, bytes]] = {}
    if not place.recipe_only and pictures is not None:
        try:
            drawn = pictures(store, progress)
        except UsageError as error:  # no matplotlib
            progress.write(f"the card has no pictures: {error}")
    words = {f"{PICTURES}/{name}": what for name, (what, _) in drawn.items()}
    return [
        Upload.of_bytes(DatasetFiles.CARD, card_text(store, words, place).encode()),
        *(Upload.of_bytes(f"{PICTURES}/{name}", data) for name, (_, data) in drawn.items()),
    ]

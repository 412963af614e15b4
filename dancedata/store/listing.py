"""What a dataset's description lists: the files that a copy of it has, in dataset.json or publication.json."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dancedata.core.errors import StoreError
from dancedata.core.text import quoted
from dancedata.files.strict_json import read_json
from dancedata.store.dataset_json import MAX_BYTES, FileEntry
from dancedata.store.schema import CARD_FILE, DATASET_FILE, PUBLICATION_FILE

_HASH = re.compile(r"[0-9a-f]{64}")
_NAME = re.compile(r"[A-Za-z0-9][\w.+-]{0,199}")


def description_of(folder: Path) -> Path:
    """Return the file of a dataset that lists the others; publication.json where only a recipe is published."""
    name = DATASET_FILE if (folder / DATASET_FILE).exists() else PUBLICATION_FILE
    return folder / name if (folder / name).exists() else folder / DATASET_FILE


def read_description(folder: Path) -> Mapping[str, Any]:
    """Return the content of a dataset's `description_of`, whose names are checked."""
    path = description_of(folder)
    document = read_json(path, MAX_BYTES)
    check_names(document, str(path))
    return dict(document)


def copied_files(document: Mapping[str, Any], splits: tuple[str, ...] | None = None) -> Iterator[FileEntry]:
    """Yield the files that dataset.json lists, those of all splits first needed first: tables, then shards.

    Not the card: it is for people, and a hub has one of its own, which its authors edit there.
    """
    for name, entry in document["files"].items():
        if name != CARD_FILE:
            yield FileEntry(name, entry["size"], entry["sha256"])
    for entry in document["shards"]:
        if splits is None or entry["split"] in splits:
            yield FileEntry(entry["file"], entry["size"], entry["sha256"])


def check_names(document: Mapping[str, Any], where: str) -> None:
    """Raise StoreError for names that lead out of the folder, and for invalid sizes and hashes."""
    try:
        for file in copied_files(document):
            size = isinstance(file.size, int) and not isinstance(file.size, bool) and file.size >= 0
            valid = size and _HASH.fullmatch(file.sha256) and _NAME.fullmatch(file.file)
            # One that is listed would replace the file that was compared with self_sha256.
            if not valid or file.file.casefold() in (DATASET_FILE, PUBLICATION_FILE):
                raise ValueError(f"file {quoted(file.file, 60)}, size {quoted(file.size, 30)}")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StoreError("a file is listed that no dataset has; nothing was fetched", where=where,
                         found=quoted(str(error), 160)) from error  # fmt: skip

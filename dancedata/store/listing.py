"""What a dataset's description lists: the files that a copy of it has, in dataset.json or publication.json."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from dancedata.core.errors import StoreError
from dancedata.core.text import quoted
from dancedata.files.listing import FileEntry
from dancedata.files.strict_json import read_json
from dancedata.store.dataset_json import MAX_BYTES
from dancedata.store.schema import CARD_FILE, DATASET_FILE, PUBLICATION_FILE, REJECTS_FILE, STATS_FILE

_HASH = re.compile(r"[0-9a-f]{64}")
_NAME = re.compile(r"[A-Za-z0-9][\w.+-]{0,199}")


@dataclass(frozen=True, eq=False)
class DatasetFiles:
    """The files that a description lists; made by `of` and `read`, which check their names."""

    #: Names of files, and the largest description, bytes.
    DATASET: ClassVar[str] = DATASET_FILE
    PUBLICATION: ClassVar[str] = PUBLICATION_FILE
    CARD: ClassVar[str] = CARD_FILE
    STATS: ClassVar[str] = STATS_FILE
    REJECTS: ClassVar[str] = REJECTS_FILE
    MAX_BYTES: ClassVar[int] = MAX_BYTES

    document: Mapping[str, Any]  # dataset.json or publication.json

    @classmethod
    def of(cls, document: Mapping[str, Any], where: object) -> Self:
        """Return the listing of a description; StoreError for names out of the folder, wrong sizes and hashes."""
        listing = cls(document)
        try:
            for file in listing.files():
                size = isinstance(file.size, int) and not isinstance(file.size, bool) and file.size >= 0
                valid = size and _HASH.fullmatch(file.sha256) and _NAME.fullmatch(file.file)
                # One that is listed would replace the file that was compared with self_sha256.
                if not valid or file.file.casefold() in (DATASET_FILE, PUBLICATION_FILE):
                    raise ValueError(f"file {quoted(file.file, 60)}, size {quoted(file.size, 30)}")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise StoreError("a file is listed that no dataset has; nothing was fetched", where=str(where),
                             found=quoted(str(error), 160)) from error  # fmt: skip
        return listing

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Return the listing of the description in a folder."""
        path = cls.path(folder)
        return cls.of(dict(read_json(path, MAX_BYTES)), path)

    @staticmethod
    def path(folder: Path) -> Path:
        """Return the file of a dataset that lists the others; publication.json where only a recipe is published."""
        name = DATASET_FILE if (folder / DATASET_FILE).exists() else PUBLICATION_FILE
        return folder / name if (folder / name).exists() else folder / DATASET_FILE

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits of the shards."""
        return tuple(dict.fromkeys(entry["split"] for entry in self.document["shards"]))

    def files(self, splits: tuple[str, ...] | None = None) -> list[FileEntry]:
        """Return the files that are listed, tables first, without the card: a hub has one that its authors edit."""
        files = [(name, entry) for name, entry in self.document["files"].items() if name != CARD_FILE]
        files += [(e["file"], e) for e in self.document["shards"] if splits is None or e["split"] in splits]
        return [FileEntry(name, entry["size"], entry["sha256"]) for name, entry in files]

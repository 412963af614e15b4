"""leaves.bin: SHA-256 of pieces of shards, so that a range of a shard can be checked without the rest."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.errors import StoreError
from dancedata.core.hashing import sha256_bytes
from dancedata.remote import RangedFile, RangeReader, Stream, origin_of, require_file
from dancedata.store.dataset_json import Description
from dancedata.store.schema import LEAVES_FILE

#: Bytes of a piece; the last one of a file is short.
LEAF = 1 << 18


def leaf_hashes(path: Path) -> tuple[str, bytes]:
    """Return the SHA-256 of a file as hex, and those of its pieces, 32 bytes each."""
    whole, leaves = hashlib.sha256(), []
    with open(path, "rb") as file:
        while piece := file.read(LEAF):
            whole.update(piece)
            leaves.append(hashlib.sha256(piece).digest())
    return whole.hexdigest(), b"".join(leaves)


def ranged_shards(folder: Path, description: Description, stream: Stream) -> Mapping[str, RangedFile]:
    """Return the shards of a dataset of an address, by name, for reading by ranges; {} for one of the local disk.

    Raises
    ------
    StoreError
        For a dataset without leaves, or whose rows are not pieces of its shards: those that another tool has written.
    """
    if origin_of(folder) is None:
        return {}
    stated = description.meta.get("leaves")
    places = [(s.file, first) for s in description.shards for first, _ in s.fields.values()]
    chunked = next((file for file, first in places if first is None), None)
    if not isinstance(stated, Mapping) or stated.get("size") != LEAF or chunked is not None:
        unknown = "the places of rows" if chunked else "the hashes of parts of shards"
        raise StoreError(
            f"the dataset cannot be read by ranges: it does not state {unknown}",
            where=str(folder),
            found=chunked,
            fix="open it without stream=True: its shards are then fetched whole",
        )
    require_file(folder / LEAVES_FILE)
    reader, begin, shards = RangeReader(folder, LEAF, stream), 0, {}
    for entry, document in zip(description.shards, description.meta["shards"], strict=True):
        n = 32 * -(-entry.size // LEAF)
        digests = _Digests(folder / LEAVES_FILE, begin, n, document.get("leaves_sha256"))
        shards[entry.file] = RangedFile(reader, entry.file, entry.size, digests)
        begin += n
    return shards


@dataclass(frozen=True)
class _Digests:
    """The part of leaves.bin of one shard, read when it is called."""

    path: Path
    begin: int
    n_bytes: int
    sha256: object

    def __call__(self) -> bytes:
        """Return the digests; StoreError unless they are those that dataset.json lists."""
        require_file(self.path)
        with open(self.path, "rb") as file:
            file.seek(self.begin)
            digests = file.read(self.n_bytes)
        if sha256_bytes(digests) != self.sha256:
            raise StoreError(
                "the hashes of a shard's parts are not those of dataset.json",
                where=str(self.path),
                found=f"bytes {self.begin} to {self.begin + self.n_bytes}",
                fix="delete this file, and open the address again",
            )
        return digests

"""leaves.bin: SHA-256 of pieces of shards, so that a range of a shard can be checked without the rest."""

import hashlib
from pathlib import Path

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

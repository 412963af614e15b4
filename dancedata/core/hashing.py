"""Hashes of files, bytes and JSON."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from dancedata.core.regular_file import open_regular


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hex; NotRegularError (an OSError) if it is not a regular file."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_bytes(*parts: bytes | memoryview) -> str:
    """Return the SHA-256 of the concatenated parts, as hex."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


#: One encoder: json.dumps creates one for every call, which takes longer than the rest of a key.
_canonical = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def canonical_json(obj: Any) -> str:
    """Return the canonical JSON text of `obj`: keys sorted, no spaces, no NaN."""
    return _canonical.encode(obj)


def canonical_bytes(obj: Any) -> bytes:
    """Return `canonical_json` as UTF-8, also of file names with lone surrogates for bytes that are not UTF-8."""
    return canonical_json(obj).encode("utf-8", "surrogatepass")


def json_sha256(obj: Any) -> str:
    """Return the SHA-256 of `canonical_bytes`, as hex."""
    return sha256_bytes(canonical_bytes(obj))

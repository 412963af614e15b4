"""Hashes of files, bytes and JSON."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hex."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_bytes(*parts: bytes | memoryview) -> str:
    """Return the SHA-256 of the parts one after another, as hex."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


#: Made once: json.dumps makes one for every call, which takes longer than the rest of a key.
_canonical = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def canonical_json(obj: Any) -> str:
    """Return the one JSON text of `obj`: keys sorted, no spaces, no NaN."""
    return _canonical.encode(obj)


def json_sha256(obj: Any) -> str:
    """Return the SHA-256 of `canonical_json`, as hex."""
    return sha256_bytes(canonical_json(obj).encode("utf-8"))

"""Hashes of bytes and JSON."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any


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


def recipe_hash(recipe: Mapping[str, Any]) -> str:
    """Return the hash of all of a recipe with its defaults that shapes the result: not its name or description."""
    return json_sha256(hashed_keys(recipe))


def self_hash(document: Mapping[str, Any]) -> str:
    """Return the hash of a document without its own key self_sha256, which is to hold it."""
    return json_sha256({key: value for key, value in document.items() if key != "self_sha256"})


def dataset_hashes(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the hashes of recipe, source and dataset, as far as a dataset.json states them."""
    source = document.get("source", {}).get("sha256")
    recipe = recipe_hash(document["recipe"]) if "recipe" in document else None
    stated = {"recipe_sha256": recipe, "source_sha256": source, "self_sha256": document.get("self_sha256")}
    return {name: sha256 for name, sha256 in stated.items() if sha256}


def document_differences(old: Any, new: Any, at: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield (key, old value, new value) for every key in which two JSON documents differ."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted({*old, *new}):
            yield from document_differences(old.get(key), new.get(key), f"{at}.{key}" if at else str(key))
    elif old != new:
        yield at, old, new


def hashed_keys(recipe: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a recipe that affect a dataset: all except its name and description."""
    return {key: value for key, value in recipe.items() if key not in ("name", "description")}

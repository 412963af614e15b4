"""Rejects of files that cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.execution.cache import Cache

_T = TypeVar("_T")


def reject_of(error: DataError, clip: str = "", file: Path | None = None) -> Reject:
    """Return the reject with the text of an error."""
    return Reject(reason=error.reason, clip=clip, file=str(file) if file else "", detail=str(error))


def attempt(call: Callable[[], _T], file: Path, clip: str = "") -> _T | Reject:
    """Return a call's result, or the reject of its DataError."""
    try:
        return call()
    except DataError as error:
        return reject_of(error, clip, file)


def require_same(cache: Cache, path: Path, sha256: str) -> None:
    """Raise DataError if a file is no longer the one that was hashed."""
    if cache.file_sha256(path) != sha256:
        raise changed(path)


def changed(where: object) -> DataError:
    """Return the error for a file that has changed since it was identified."""
    fix = "run the build again once the source no longer changes"
    return DataError("the file changed while the build was running", reason="changed", where=where, fix=fix)


def missing_music(ref: ClipRef) -> Reject:
    """Return the reject of a clip without music."""
    detail = f"no music for clip {ref.id}; a recipe without audio features (audio: {{}}) needs none"
    return Reject("missing_music", clip=ref.id, detail=detail, music=ref.music)

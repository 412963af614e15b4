"""Rejects of files that cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError

_T = TypeVar("_T")
CHANGED = "the file changed while the build was running"
BUILD_AGAIN = "run the build again once the source no longer changes"


def reject_of(error: DataError, clip: str = "", file: Path | None = None) -> Reject:
    """Return the reject with the text of an error."""
    return Reject(reason=error.reason, clip=clip, file=str(file) if file else "", detail=str(error))


def attempt(call: Callable[[], _T], file: Path, clip: str = "") -> _T | Reject:
    """Return a call's result, or the reject of its DataError."""
    try:
        return call()
    except DataError as error:
        return reject_of(error, clip, file)


def missing_music(ref: ClipRef) -> Reject:
    """Return the reject of a clip without music."""
    detail = f"no music for clip {ref.id}; a recipe without audio features (audio: {{}}) needs none"
    return Reject("missing_music", clip=ref.id, detail=detail, music=ref.music)

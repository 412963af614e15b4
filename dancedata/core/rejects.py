"""Rejects of clips and files, and the reasons that are a choice."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.text import printable

_T = TypeVar("_T")

#: Reasons for which a clip is left out by choice; they do not stop a strict build.
BY_CHOICE = {
    "ignored",
    "unassigned",
    "missing_motion",
    "unused_music",
    "extra_file",
    "no_audio",
    "still",
    "filtered",
    "curated",
    "short_field",
    "no_field",
    "unmirrored_words",
    "unused_segments",
}


def reject_of(error: DataError, clip: str = "", file: Path | None = None) -> Reject:
    """Return the reject with the text of an error."""
    return Reject(reason=error.reason, clip=clip, file=str(file) if file else "", detail=str(error))


def reject_on_error(call: Callable[[], _T], file: Path, clip: str = "") -> _T | Reject:
    """Return a call's result, or the reject of its DataError."""
    try:
        return call()
    except DataError as error:
        return reject_of(error, clip, file)


def require_same(path: Path, sha256: str, hash_file: Callable[[Path], str]) -> None:
    """Raise DataError if a file is no longer the one that was hashed."""
    if hash_file(path) != sha256:
        raise changed(path)


def changed(where: object) -> DataError:
    """Return the error for a file that has changed since it was identified."""
    fix = "run the build again once the source no longer changes"
    return DataError("the file changed while the build was running", reason="changed", where=where, fix=fix)


def missing_music(ref: ClipRef) -> Reject:
    """Return the reject of a clip without music."""
    detail = f"no music for clip {ref.id}; a recipe without audio features (audio: {{}}) needs none"
    return Reject("missing_music", clip=ref.id, detail=detail, music=ref.music)


def relative_to(reject: Reject, source: Path) -> Reject:
    """Name files relative to the source: its place affects no byte of a dataset."""
    prefix = printable(f"{source}{os.sep}")
    return replace(reject, file=reject.file.removeprefix(prefix), detail=reject.detail.replace(prefix, ""))

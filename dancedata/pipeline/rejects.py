"""What worker processes say of files that are broken, or change under a build."""

from __future__ import annotations

from pathlib import Path

from dancedata.core.clip import Reject
from dancedata.core.errors import DataError
from dancedata.core.quality import IMPLAUSIBLE

CHANGED = "the file changed while the build was running"
BUILD_AGAIN = "run the build again when the source is at rest"

#: Reasons for which a clip is left out by choice; they do not stop a strict build.
BY_CHOICE = {
    "ignored",
    "unassigned",
    "missing_motion",
    "unused_music",
    "extra_file",
    "no_audio",
    "still",
    "short_field",
}

#: Reasons that `check` reports as notes; all others are errors.
NOTED = {*BY_CHOICE, *IMPLAUSIBLE}


def reject_of(error: DataError, clip: str = "", file: Path | None = None) -> Reject:
    """Say in rejects.jsonl what an error says."""
    return Reject(reason=error.reason, clip=clip, file=str(file) if file else "", detail=str(error))

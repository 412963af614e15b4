"""Rejects: the reasons for which clips and files are left out, as text and as errors."""

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dancedata.core.clip import Reject, Scan
from dancedata.core.errors import DataError, StoreError
from dancedata.core.plugins import Dataset
from dancedata.core.quality import OF_CLIPS
from dancedata.core.rejects import BY_CHOICE
from dancedata.core.text import counted, shown
from dancedata.store import Store

#: Reasons that `check` reports as notes; all others are errors.
NOTED = {*BY_CHOICE, *OF_CLIPS}


def reasons(store: Store) -> dict[str, int]:
    """Return how many were left out for each reason."""
    return dict(sorted(Counter(row["reason"] for row in store.rejects).items()))


def empty_build_error(source: Path, dataset: Dataset, scan: Scan, rejects: Sequence[Reject]) -> StoreError:
    """Return the error of a source of which no clip can be stored: reasons, notes of the reader, fix."""
    text = _report("no clip is left to build from", rejects, scan)
    # For files of any layout, only the recipe has the declarations.
    reader = f" --recipe {dataset.name}"
    if dataset.explicit_only:
        reader = "" if (source / "recipe.yaml").is_file() else " --recipe RECIPE, with the recipe of this build"
    fix = f"see every file: dancedata check {shlex.quote(shown(source))}{reader}"
    without_music = {clip.id for clip in scan.clips if clip.audio_path is None}
    if any(r.reason == "missing_music" and r.clip in without_music for r in rejects):
        fix = f"audio features need music; to build motion alone: --set 'audio={{}}'. {fix[0].upper()}{fix[1:]}"
    return StoreError(text, where=source, fix=fix)


def require_no_rejects(
    strict: bool, rejects: Sequence[Reject], scan: Scan, quality: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Raise DataError for broken clips, and implausible ones by their quality flags, if the build is strict."""
    if not strict:
        return
    from dancedata.core.implausible import require_plausible

    broken = [r for r in rejects if r.reason not in BY_CHOICE]
    if broken:
        text = _report(f"{counted(len(broken), 'broken clip')} in a strict build", broken, scan)
        fix = "repair or remove the broken files, or build without --strict to leave their clips out"
        raise DataError(text, reason=broken[0].reason, fix=fix)
    require_plausible(quality)


def _report(problem: str, rejects: Sequence[Reject], scan: Scan) -> str:
    from dancedata.core.left_out import left_out_lines

    left_out = left_out_lines(rejects, details=True)
    lines = [f"  {line}" if line.startswith(" ") else f"  - {line}" for line in left_out]
    notes = [f"  - {note}" for note in scan.notes]
    return "\n".join([problem, *lines, "what was found in the source", *notes]) + "\n"

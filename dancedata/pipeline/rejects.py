"""Rejects: why clips and files are left out, as worker processes and stages report it."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.quality import OF_CLIPS
from dancedata.recipes.recipe import Recipe

CHANGED = "the file changed while the build was running"
BUILD_AGAIN = "run the build again once the source no longer changes"

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
    "short_field",
}

#: Reasons that `check` reports as notes; all others are errors.
NOTED = {*BY_CHOICE, *OF_CLIPS}


def reject_of(error: DataError, clip: str = "", file: Path | None = None) -> Reject:
    """Return the reject with the text of an error."""
    return Reject(reason=error.reason, clip=clip, file=str(file) if file else "", detail=str(error))


def missing_music(ref: ClipRef) -> Reject:
    """Return the reject of a clip without music."""
    detail = f"no music for clip {ref.id}; a recipe without audio features (audio: {{}}) needs none"
    return Reject("missing_music", clip=ref.id, detail=detail, music=ref.music, fix=ref.music_fix)


def too_short(recipe: Recipe, ref: ClipRef, n_frames: int, rate: Fraction) -> Reject:
    """Return the reject of a clip whose motion, of so many frames at its own rate, is shorter than a window."""
    motion_s = float(FrameGrid(rate).seconds(n_frames))
    detail = (
        f"clip {ref.id} is shorter than a window: {n_frames} frames at {rate} per second "
        f"({motion_s:.2f} s); a window is {recipe.windows.length_s:g} s"
    )
    numbers: dict[str, float | int] = {"motion_s": round(motion_s, 3)}
    return Reject("too_short", ref.id, str(ref.motion_path), detail=detail, numbers=numbers)


def short_audio(recipe: Recipe, ref: ClipRef, path: Path, audio_s: float) -> Reject:
    """Return the reject of a clip whose music is shorter than a window."""
    detail = f"{path}: the music is shorter than a window: {audio_s} s; a window is {recipe.windows.length_s:g} s"
    numbers: dict[str, float | int] = {"audio_s": audio_s}
    return Reject("short_audio", ref.id, str(path), detail=detail, numbers=numbers)

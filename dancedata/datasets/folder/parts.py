"""Parts of motion files that are clips, and the second of the music at which they begin."""

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

from dancedata.core.clip import FOUND, ClipRef
from dancedata.core.errors import DataError
from dancedata.core.motion import Motion
from dancedata.core.text import counted


def part_of(motion: Motion, ref: ClipRef) -> Motion:
    """Return the frames of a file that are the clip; see `ClipRef.source_start`.

    Raises DataError: ``too_short`` if no frame is left, ``bad_declaration`` if the file ends before the part does.
    """
    if ref.source_start is None and ref.source_end is None:
        return motion
    rate, n = motion.grid.rate, motion.n_frames
    first = int((ref.source_start or 0) * rate)
    stop = n if ref.source_end is None else int(ref.source_end * rate)
    if not first < stop or first >= n or stop > n:
        beyond = stop > n > first
        raise DataError(
            "the part of the manifest goes beyond the motion file" if beyond else "no frame of the part is left",
            reason="bad_declaration" if beyond else "too_short",
            where=str(ref.motion_path),
            found=f"frames {first:,} to {stop:,} by start_s and end_s, of {n:,} at {motion.grid} per second",
            allowed=f"0 to {float(motion.grid.seconds(n)):g} s",
            fix=f"correct start_s or end_s of clip {ref.id} in the manifest; an empty end_s is the end of the file",
        )
    return motion.part(first, stop)


def on_frames(ref: ClipRef, rate: Fraction) -> ClipRef:
    """Return a clip whose part begins and ends at whole frames of its file, the nearest ones, and its music there."""
    first, stop = (
        None if second is None else Fraction(math.floor(second * rate + Fraction(1, 2))) / rate
        for second in (ref.source_start, ref.source_end)
    )
    return replace(ref, source_start=first or None, source_end=stop, audio_start=ref.audio_start + (first or 0))


def part_notes(clips: Sequence[ClipRef]) -> list[str]:
    """Return notes on the parts and offsets that a manifest states."""
    parts = [clip for clip in clips if clip.source_start is not None or clip.source_end is not None]
    late = sum(bool(clip.audio_start) for clip in clips)
    left = sum(clip.audio_start_by == FOUND for clip in clips)
    notes = []
    if parts:
        files = len({clip.motion_path for clip in parts})
        notes.append(
            f"Parts: {counted(len(parts), 'clip')} of {counted(files, 'motion file')} by start_s and end_s, from and "
            "to the nearest frame."
        )
    if late:
        notes.append(f"Music: audio_start_s states the offset of {counted(late, 'clip')}.")
    if left:
        notes.append(f"Music: audio_start_s leaves the offset of {counted(left, 'clip')} to the build (auto).")
    return notes

"""Whether a clip's motion and music are of one length, by the headers of the two files."""

from __future__ import annotations

from pathlib import Path

from dancedata.core.grid import FrameGrid
from dancedata.core.regular_file import open_regular
from dancedata.datasets.finedance.load import motion_length

__all__ = ["MAX_DIFFERENCE", "length_note"]

MAX_DIFFERENCE = 2
"""Frames by which motion and music of the published files differ at most, as their users report."""


def length_note(motion: Path, music: Path, frame_rate: int) -> str:
    """Say how long the two are if they differ by more than `MAX_DIFFERENCE` frames; "" if not, or not known.

    A file that cannot be read has no length here; that it is broken is found when it is loaded.
    """
    frames, (n_samples, sample_rate) = motion_length(motion), _music_length(music)
    if frames is None or not n_samples:
        return ""
    # As many rows as features of the music have, one at every frame that begins within it.
    rows = FrameGrid.of(sample_rate).rows_up(n_samples, of=FrameGrid.of(frame_rate))
    if abs(frames - rows) <= MAX_DIFFERENCE:
        return ""
    return f"motion {frames / frame_rate:.2f} s, music {n_samples / sample_rate:.2f} s"


def _music_length(path: Path) -> tuple[int, int]:
    """Return samples and sample rate as the header states them; no samples if it states none."""
    import soundfile

    try:
        with open_regular(path) as file:
            info = soundfile.info(file)
    except (soundfile.SoundFileError, OSError, ValueError, TypeError):
        return 0, 1
    return max(int(info.frames), 0), max(int(info.samplerate), 1)

"""Compares the lengths of a clip's motion and music by the headers of the two files."""

from __future__ import annotations

from pathlib import Path

from dancedata.core.grid import FrameGrid
from dancedata.files.regular_file import open_regular

__all__ = ["MAX_DIFFERENCE", "length_note"]

#: Largest difference between motion and music in the published files, in frames, as reported by users.
MAX_DIFFERENCE = 2


def length_note(motion: Path, music: Path, frame_rate: int) -> str:
    """Return both lengths if they differ by more than `MAX_DIFFERENCE` frames; "" if not, or if one is unknown.

    The length of an unreadable file is unknown; loading it reports the error.
    """
    from dancedata.datasets.finedance.load import motion_length

    frames, (n_samples, sample_rate) = motion_length(motion), _music_length(music)
    if frames is None or not n_samples:
        return ""
    # The rows of audio features: one for every frame that begins within the audio.
    rows = FrameGrid.of(sample_rate).rows_up(n_samples, of=FrameGrid.of(frame_rate))
    if abs(frames - rows) <= MAX_DIFFERENCE:
        return ""
    return f"motion {frames / frame_rate:.2f} s, music {n_samples / sample_rate:.2f} s"


def _music_length(path: Path) -> tuple[int, int]:
    """Return samples and sample rate in the header; 0 samples if the length is unknown."""
    import soundfile

    try:
        with open_regular(path) as file:
            info = soundfile.info(file)
    except (soundfile.SoundFileError, OSError, ValueError, TypeError):
        return 0, 1
    return max(int(info.frames), 0), max(int(info.samplerate), 1)

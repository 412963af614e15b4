"""ffmpeg: raw frames and a wav file become an mp4 file."""

from __future__ import annotations

import errno
import io
import os
import shutil
import signal
import subprocess
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, cast

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.packages import install, load, require
from dancedata.core.text import shown
from dancedata.execution.reference_process import shielded
from dancedata.files import atomic

__all__ = ["find_ffmpeg", "write_mp4"]

#: Errors of a disk or quota without room.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def find_ffmpeg() -> str:
    """Return the path of ffmpeg: that of the system, else that of the package imageio-ffmpeg.

    Raises
    ------
    UsageError
        If there is none.
    """
    own = shutil.which("ffmpeg")
    if own is not None:
        return own
    instead = "Or install ffmpeg with the packages of your system"
    require("video", ["imageio_ffmpeg"], what="a video needs ffmpeg, or its Python package:", instead=instead)
    try:
        return str(load("imageio_ffmpeg", "video").get_ffmpeg_exe())
    except RuntimeError as error:
        raise UsageError("a video needs ffmpeg", found=shown(error), fix=instead) from error


def write_mp4(
    path: Path,
    frames: Iterable[bytes],
    size: tuple[int, int],
    rate: Fraction,
    sound: AudioSignal | None,
    *,
    comment: str = "",
) -> None:
    """Write frames as H.264 and a sound as AAC; no date and no version is stored.

    Parameters
    ----------
    frames
        RGB bytes of each frame.
    rate
        Frames per second.
    sound
        Of the same length; None for a silent video.
    comment
        Text that is stored in the file.

    Raises
    ------
    UsageError
        If there is no ffmpeg.
    StoreError
        If ffmpeg fails, such as one without H.264.
    OSError
        If the file cannot be written, such as on a full disk.
    """
    program = find_ffmpeg()
    with atomic.atomic_file(path) as temporary, TemporaryDirectory(prefix="dancedata-video-") as folder:
        command = [program, "-hide_banner", "-loglevel", "error", "-y",
                   "-f", "rawvideo", "-pixel_format", "rgb24", "-video_size", f"{size[0]}x{size[1]}",
                   "-framerate", f"{rate.numerator}/{rate.denominator}", "-i", "pipe:0"]  # fmt: skip
        if sound is not None:
            wav = Path(folder, "sound.wav")
            _write_wav(wav, sound)
            command += ["-i", str(wav), "-map", "0:v", "-map", "1:a", "-c:a", "aac", "-b:a", "160k"]
        command += ["-c:v", "libx264", "-preset", "medium", "-crf", "20", "-pix_fmt", "yuv420p",
                    "-movflags", "+faststart", "-fflags", "+bitexact", "-flags:v", "+bitexact",
                    "-flags:a", "+bitexact", "-map_metadata", "-1", "-metadata", f"comment={comment}",
                    "-f", "mp4", str(temporary)]  # fmt: skip
        said = _run(command, frames, Path(folder, "messages"))
        if said is not None:
            raise StoreError(
                "ffmpeg cannot write the video",
                where=path,
                found=shown(said.replace(str(temporary), path.name), 600),
                fix="use an ffmpeg with libx264 and aac; imageio-ffmpeg brings one: " + install("video"),
            )


def _write_wav(path: Path, sound: AudioSignal) -> None:
    import soundfile

    data = io.BytesIO()  # where it writes a file itself, a full disk is an error of its own
    soundfile.write(data, sound.samples, sound.sample_rate, subtype="PCM_16", format="WAV")
    path.write_bytes(data.getbuffer())


def _run(command: list[str], frames: Iterable[bytes], messages: Path) -> str | None:
    """Run ffmpeg; returns what it said where it failed, OSError where it could not write for want of room."""
    # The program is the one that was found, and no argument passes a shell. Its messages go to a file: a pipe that
    # nothing reads would stop it once it is full.
    with messages.open("wb") as errors, ExitStack() as stack:
        with shielded():  # a signal while it starts would leave it running
            process = stack.enter_context(
                subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors)  # noqa: S603
            )
            stack.callback(process.kill)
        _feed(cast("IO[bytes]", process.stdin), frames)
        process.wait()
    if not process.returncode:
        return None
    said = messages.read_bytes().decode(errors="replace").strip()
    full = [number for number in _FULL if os.strerror(number) in said]
    if full or process.returncode == -signal.SIGXFSZ:
        number = full[0] if full else errno.EFBIG
        raise OSError(number, os.strerror(number))
    return said


def _feed(pipe: IO[bytes], frames: Iterable[bytes]) -> None:
    with suppress(BrokenPipeError):  # it has ended with an error, which its exit code tells
        for frame in frames:
            pipe.write(frame)
        pipe.close()

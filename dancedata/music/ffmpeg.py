"""ffmpeg, where it is installed: decodes sound that libsndfile cannot read."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import IO, cast

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import UsageError
from dancedata.core.packages import install, load
from dancedata.core.text import shown

#: What may be read: no playlists, which name other files.
_FORMATS = (
    "aac,ac3,aiff,amr,ape,asf,au,avi,caf,dsf,eac3,flac,flv,matroska,mov,mp3,mpeg,mpegts,ogg,rm,tta,voc,w64,wav,wv"
)
_STREAM = re.compile(r"\[info\] +Stream #0:\d+.*?: Audio: ")
#: Seconds at which the first of all streams of a file begins, and that of its sound.
_FILE_START = re.compile(r"\[info\] +Duration: .*?, start: (-?[\d.]+)")
_START = re.compile(r"\[info\] +Stream #0:\d+.*?: Audio: .*?, start (-?[\d.]+)")
_ERROR = re.compile(r"^(?:\[[^]]*\] )*\[(?:error|fatal|panic)\] (.*)$", re.MULTILINE)


class NotDecodedError(Exception):
    """Why ffmpeg does not decode the sound; with `options` it could write it as wav, None where it cannot."""

    def __init__(self, problem: str, options: str | None = None) -> None:
        super().__init__(problem)
        self.options = options


def find_ffmpeg() -> str:
    """Return the path of ffmpeg, that of imageio-ffmpeg or the system's; UsageError if neither is installed."""
    try:
        return str(load("imageio_ffmpeg", "video").get_ffmpeg_exe())
    except (UsageError, RuntimeError) as error:
        installed = shutil.which("ffmpeg")
        if installed is None:
            raise UsageError("ffmpeg is not installed", fix=install("video")) from error
        return installed


def ffmpeg_version() -> str:
    """Return the version of the ffmpeg that decodes; "" if there is none."""
    try:
        return _version(find_ffmpeg())
    except UsageError:
        return ""


@lru_cache(maxsize=4)
def _version(program: str) -> str:
    try:
        done = subprocess.run(  # noqa: S603 -- no argument passes a shell
            [program, "-version"], capture_output=True, text=True, errors="replace", check=False
        )
    except OSError:
        return ""
    words = done.stdout.split()
    return shown(words[2], 40) if words[:2] == ["ffmpeg", "version"] else ""


def decode(path: Path, limit: int) -> tuple[NDArray[np.float32], int, str, float]:
    """Decode the sound of a file or of a video, at most `limit` bytes of float32 samples; else NotDecodedError.

    Returns samples (n, channels), their rate, ffmpeg's own errors, of damage that it has skipped, and the seconds
    from the first picture to the first sample.
    """
    try:
        program = find_ffmpeg()
    except UsageError as error:
        raise NotDecodedError("ffmpeg, which may read it, is not installed", "") from error
    command = [program, "-nostdin", "-hide_banner", "-nostats", "-loglevel", "level+info", "-threads", "1",
               "-protocol_whitelist", "file", "-format_whitelist", _FORMATS, "-i", f"file:{path.absolute()}",
               "-map", "0:a:0", "-c:a", "pcm_f32be", "-bitexact", "-f", "au", "-"]  # fmt: skip
    with tempfile.TemporaryFile() as messages:
        try:
            started = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=messages)  # noqa: S603
            with started as process:
                sound, output = bytearray(), cast("IO[bytes]", process.stdout)
                while len(sound) <= limit and (piece := output.read(1 << 20)):
                    sound += piece
                if len(sound) > limit:
                    process.kill()
        except OSError as error:
            raise NotDecodedError(f"ffmpeg cannot be started: {error}") from error
        messages.seek(0)
        text = messages.read(1 << 20).decode(errors="replace")
    if len(sound) > limit:
        raise NotDecodedError(f"ffmpeg decodes more than {limit:,} bytes")
    n_streams = len(_STREAM.findall(text.partition("Output #0")[0]))
    errors = "; ".join(dict.fromkeys(line.strip() for line in _ERROR.findall(text)))
    if n_streams > 1:
        raise NotDecodedError(f"{n_streams} streams of sound, to choose from", " -map 0:a:0")
    if n_streams == 0 and "Input #0" in text:
        raise NotDecodedError("ffmpeg: no stream of sound")
    first, rate, channels = (int.from_bytes(sound[k : k + 4], "big") for k in (4, 16, 20))
    if process.returncode or len(sound) <= first or not rate or not channels:
        raise NotDecodedError(f"ffmpeg: {shown(errors or 'no sound', 300)}")
    samples = np.frombuffer(sound, ">f4", offset=first)
    samples = samples[: len(samples) // channels * channels].reshape(-1, channels)
    starts = [float(found[1]) if (found := begun.search(text)) else 0.0 for begun in (_FILE_START, _START)]
    return samples.astype(np.float32), rate, shown(errors, 300), max(0.0, starts[1] - starts[0])

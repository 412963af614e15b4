"""Audio files in, mono float32 samples out: decode, average the channels.

libsndfile decodes wav (8 to 32 bit, float), flac, ogg, opus, mp3, aiff and more, as `librosa.load` to the bit. Where
it cannot read a file, or not all of it (see `sound_files`), ffmpeg does, if it is installed; this is the way of m4a,
aac and videos. Samples keep the rate of the file; each feature resamples as it needs (`samples`).
"""

from __future__ import annotations

import io
import math
import mmap
import os
import shlex
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError
from dancedata.core.packages import install
from dancedata.core.text import shown
from dancedata.files.regular_file import open_regular
from dancedata.music.ffmpeg import NotDecodedError, decode
from dancedata.music.sound_files import Held, held

if TYPE_CHECKING:
    from collections.abc import Iterator
    from io import BufferedReader

    import soundfile

#: Most bytes that are decoded (float32 samples of all channels) or that resampling may give: three hours of stereo at
#: 48 kHz, six of mono.
MAX_BYTES = 1 << 32
#: Sample rates that are accepted, in Hz: telephones have 8,000, studios 192,000.
MIN_RATE, MAX_RATE = 4_000, 400_000
#: About the highest rate of the features: the size of a resampled signal is bounded at this rate.
_FEATURE_RATE = 48_000
#: Energy of a mix to mono, relative to that of a mix of unrelated channels, below which the channels cancel: -20 dB.
_LEAST_MIX = 0.01
#: Above BOMB_BYTES, decoding may enlarge a file this many times; the most in real use is speech in opus, 250-fold.
BOMB_BYTES = 1 << 26
BOMB_RATIO = 1000
#: Music that ends later than its file by less is not cut, seconds.
_CUT_S = 0.02
#: Sound that begins after the first picture of its video by less is in time with it, seconds.
_EARLY_S = 0.03


def load_audio(path: Path | str) -> AudioSignal:
    """Decode a whole file and average its channels.

    `path`: Any file that libsndfile reads: wav, flac, ogg, mp3, ...; with ffmpeg others, such as m4a and mp4.
    Returns: Samples (n,) float32 at the file's rate. Samples of float files may exceed +-1. Its findings say if
        ffmpeg has decoded it, if an encoder's delay was kept, and what a cut file lacks.
    Raises DataError: With reason ``missing_file``, ``broken_audio`` (not decodable, or not whole), ``empty_audio``
        (no sample), ``nan`` (NaN or infinite samples) or ``antiphase`` (channels that cancel: their mean has lost the
        music).

    A truncated wav, ogg or mp3 file gives the samples that it still has. The sound of a file is never silently
    shorter: where a decoder would stop before its end, another one reads it, or it is ``broken_audio``.
    """
    path = Path(path)
    decoded = _decode(path)
    samples, sample_rate = decoded.samples, decoded.rate
    mono = _mean_of_channels(samples)
    _require_mix(path, samples, mono)
    bad = np.flatnonzero(~np.isfinite(mono))
    if bad.size:
        raise DataError("the audio has samples that are not finite", reason="nan", where=str(path),
                        found=f"{bad.size} NaN or infinite samples, the first at {bad[0] / sample_rate:.3f} s",
                        allowed="finite samples", fix="export the file again, for example as 16-bit wav")  # fmt: skip
    del samples, decoded.samples  # twice as large where there are two channels
    return AudioSignal(np.ascontiguousarray(mono, dtype=np.float32), sample_rate, decoded.findings)


def _mean_of_channels(samples: NDArray[np.float32]) -> NDArray[np.float32]:
    """Average (n, channels) as numpy's mean does, to the bit; on so short an axis numpy takes six times as long."""
    n_channels = samples.shape[1]
    if n_channels >= 8:  # numpy adds these in another order
        return np.asarray(np.mean(samples.T, axis=0))
    total = samples[:, 0].copy()
    for channel in range(1, n_channels):
        total += samples[:, channel]
    if n_channels > 1:
        total /= np.float32(n_channels)
    return total


def _require_mix(path: Path, samples: NDArray[np.float32], mono: NDArray[np.float32]) -> None:
    """Raise DataError if the mean of the channels is nearly silent, and the channels are not."""
    n_channels = samples.shape[1]
    total = float(np.vdot(samples, samples))
    # 1 for unrelated channels, `n_channels` for equal ones.
    kept = n_channels**2 * float(np.vdot(mono, mono)) / total if total > 0 else 1.0
    if n_channels > 1 and kept < _LEAST_MIX:
        level = f"{10 * math.log10(kept):.0f} dB" if kept > 0 else "silent"
        raise DataError("the channels are in antiphase: their mean, from which features are computed, has lost the "
                        "music", reason="antiphase", where=str(path),
                        found=f"a mix of {n_channels} channels, {level} relative to that of unrelated channels",
                        allowed=f"{10 * math.log10(_LEAST_MIX):.0f} dB or more",
                        fix="export the file again as mono, or with one channel inverted")  # fmt: skip


def audio_length(path: Path | str) -> tuple[int, int]:
    """Return the samples per channel, exactly those of `load_audio`, and the sample rate in Hz, of a file.

    Only headers are read, except where they are estimates (a factor of 2.5 off was seen in mp3) or wrong: then the
    file is decoded. DataError as in `load_audio`, but a truncated flac file and NaN are only found by decoding.
    """
    path = Path(path)
    found = _held(path)
    if not found.problem:
        try:
            with _opened(path, found.begin) as sound:
                n_samples, rate = int(sound.frames), int(sound.samplerate)
                if n_samples and not _is_mp3(sound) and not found.is_cut(n_samples, rate):
                    return n_samples, rate
        except _NotReadError:
            pass
    decoded = _decode(path)
    return len(decoded.samples), decoded.rate


class _NotReadError(Exception):
    """libsndfile cannot read a file."""


@contextmanager
def _opened(path: Path, begin: int = 0) -> Iterator[soundfile.SoundFile]:
    """Yield a file that libsndfile has opened; _NotReadError for the errors of it and of soundfile, of many types."""
    import soundfile

    # A Python file object: file names in any script work on any system.
    with _open(path) as file:
        try:
            file.seek(begin)
            with soundfile.SoundFile(io.BytesIO(file.read()) if begin else file) as sound:
                _require_plausible(path, sound, os.fstat(file.fileno()).st_size)
                yield sound
        except (DataError, OSError, MemoryError):
            raise
        except Exception as error:
            raise _NotReadError(str(getattr(error, "error_string", error)).strip()) from error


def _require_plausible(path: Path, sound: soundfile.SoundFile, size: int) -> None:
    """Refuse an implausible length or rate in the header: memory is allocated before samples are read."""
    rate, frames, channels = int(sound.samplerate), int(sound.frames), int(sound.channels)
    _require_rate(path, rate)
    decoded, resampled = 4 * frames * channels, 4 * frames * _FEATURE_RATE // rate
    if frames < 0 or max(decoded, resampled) > _most_bytes(size):
        what = "once decoded" if decoded >= resampled else f"once resampled to {_FEATURE_RATE:,} Hz"
        raise _broken(path, f"a header with {frames:,} samples in {channels} channels at {rate:,} Hz, "
                      f"{max(decoded, resampled):,} bytes {what}, in a file of {size:,} bytes")  # fmt: skip


def _open(path: Path) -> BufferedReader:
    try:
        return open_regular(path)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise DataError("the audio file does not exist", reason="missing_file", where=str(path),
                        found="a folder" if isinstance(error, IsADirectoryError) else "nothing",
                        allowed="an audio file (wav, flac, ogg, mp3)") from error  # fmt: skip
    except OSError as error:
        raise _broken(path, str(error)) from error


def _held(path: Path) -> Held:
    """Examine the structure of a file."""
    with _open(path) as file:
        if not os.fstat(file.fileno()).st_size:
            return Held("a file of 0 bytes", refused=True)
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return held(data)  # type: ignore[arg-type]  # a map reads as bytes do


def _require_rate(path: Path, rate: int) -> None:
    if not MIN_RATE <= rate <= MAX_RATE:
        raise _broken(path, f"a sample rate of {rate:,} Hz", allowed=f"{MIN_RATE:,} to {MAX_RATE:,} Hz",
                      fix="export the file again at 44100 or 48000 Hz")  # fmt: skip


def _most_bytes(size: int) -> int:
    """Return how large a file of so many bytes may become."""
    return min(MAX_BYTES, max(BOMB_BYTES, BOMB_RATIO * size))


@dataclass
class _Decoded:
    """All samples, (n, channels) float32, their rate, and what was noticed."""

    samples: NDArray[np.float32]
    rate: int
    findings: tuple[tuple[str, float], ...]


def _decode(path: Path) -> _Decoded:
    found = _held(path)
    if found.refused:
        raise _broken(path, found.problem)
    problem, findings, start_s = found.problem, [], 0.0
    if not problem:
        try:
            samples, rate = _read(path, found.begin)
            if found.is_cut(len(samples), rate):
                problem = f"{len(samples) / rate:.2f} s of {found.seconds:.2f} s are read"
        except _NotReadError as error:
            problem = str(error)
    if problem:
        samples, rate, start_s = _read_by_ffmpeg(path, found, problem)
        findings.append(("decoded_by_ffmpeg", len(samples) / rate))
    if not len(samples):
        raise DataError("the audio file has no samples", reason="empty_audio", where=str(path), found="0 samples",
                        allowed="at least one sample", fix="copy or export the file again")  # fmt: skip
    findings += [("late_music", found.delay_s)] if found.delay_s else []
    findings += [("early_music", start_s)] if start_s > _EARLY_S else []
    cut_s = found.cut_s + found.cut * len(samples) / rate
    findings += [("cut_music", cut_s)] if cut_s > _CUT_S else []
    return _Decoded(samples, rate, tuple((kind, round(value, 3)) for kind, value in findings))


def _read(path: Path, begin: int) -> tuple[NDArray[np.float32], int]:
    with _opened(path, begin) as sound:
        # soundfile counts what is left by seeking, which some formats (GSM, G.72x) cannot. Blocks would not do:
        # soundfile seeks after every one, and in a damaged mp3 file that leads to another place.
        n = -1 if sound.seekable() else sound.frames
        samples: NDArray[np.float32] = sound.read(n, dtype="float32", always_2d=True)
        # The header of mp3 is an estimate; in other formats `audio_length` has returned its length.
        if 0 < len(samples) != sound.frames and not _is_mp3(sound):
            raise _NotReadError(f"{len(samples):,} samples instead of the {sound.frames:,} in the header")
        return samples, int(sound.samplerate)


def _read_by_ffmpeg(path: Path, found: Held, problem: str) -> tuple[NDArray[np.float32], int, float]:
    """Read all samples, and the second of the first one; DataError if they are fewer than there are, or damaged."""
    size = path.stat().st_size
    try:
        samples, rate, errors, start_s = decode(path, _most_bytes(size))
    except NotDecodedError as error:
        fix = ""
        if error.options is not None:
            fix = f"ffmpeg -n -i {shlex.quote(path.name)}{error.options} {shlex.quote(path.stem + '.wav')}"
            fix += "" if error.options else f"; or install ffmpeg, which is then used by itself: {install('video')}"
        raise _broken(path, f"{problem}; {error}", fix=fix) from error
    _require_rate(path, rate)
    if 4 * len(samples) * _FEATURE_RATE // rate > _most_bytes(size):
        raise _broken(path, f"{len(samples):,} samples at {rate:,} Hz in a file of {size:,} bytes")
    other = found.exact and len(samples) != round(found.seconds * rate)
    if other or found.is_cut(len(samples), rate) or (errors and not found.seconds):
        decoded = f"{problem}; ffmpeg decodes {len(samples) / rate:.2f} s"
        raise _broken(path, f"{decoded} of {found.seconds:.2f} s" if found.seconds else f"{decoded}: {shown(errors)}")
    return samples, rate, start_s


def _is_mp3(sound: soundfile.SoundFile) -> bool:
    return "MPEG" in str(sound.format) or "MPEG" in str(sound.subtype)


def _broken(
    path: Path, message: str, allowed: str = "a complete wav, flac, ogg, mp3 or other sound file", fix: str = ""
) -> DataError:
    return DataError("the audio file cannot be decoded", reason="broken_audio", where=str(path), found=message,
                     allowed=allowed, fix=fix or "copy or export the file again, as wav if in doubt")  # fmt: skip

"""Audio files in, mono float32 samples out: decode, average the channels, quantise, resample.

All formats that libsndfile decodes are accepted: wav (8 to 32 bit, float), flac, ogg, mp3. Samples keep the rate of
the file; each feature resamples as it needs. Decoding and resampling match `librosa.load` to the bit.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError
from dancedata.files.regular_file import open_regular

if TYPE_CHECKING:
    from types import TracebackType

    import soundfile

# Largest undecoded part of an mp3 file that tags (lyrics, pictures) at its end can explain.
_MAX_UNREAD_MP3 = 0.2
#: Most bytes that are decoded (float32 samples of all channels) or that resampling may give: three hours of stereo at
#: 48 kHz, six of mono.
MAX_BYTES = 1 << 32
#: Sample rates that are accepted, in Hz: telephones have 8,000, studios 192,000.
MIN_RATE, MAX_RATE = 4_000, 400_000
#: About the highest rate of the features: the size of a resampled signal is bounded at this rate.
FEATURE_RATE = 48_000
#: Energy of a mix to mono, relative to that of a mix of unrelated channels, below which the channels cancel: -20 dB.
LEAST_MIX = 0.01
#: Above BOMB_BYTES, decoding may enlarge a file this many times; the most in real use is speech in opus, 250-fold.
BOMB_BYTES = 1 << 26
BOMB_RATIO = 1000


def load_audio(path: Path | str) -> AudioSignal:
    """Decode a whole file and average its channels.

    Parameters
    ----------
    path
        Any file that libsndfile reads: wav, flac, ogg, mp3, ...

    Returns
    -------
    AudioSignal
        Samples (n,) float32 at the file's rate. Samples of float files may exceed +-1.

    Raises
    ------
    DataError
        With reason ``missing_file``, ``broken_audio`` (not decodable), ``empty_audio`` (no sample), ``nan``
        (NaN or infinite samples) or ``antiphase`` (channels that cancel: their mean has lost the music).

    Notes
    -----
    A truncated wav, ogg or mp3 file gives the samples that it still has, a truncated flac file is ``broken_audio``.
    libsndfile estimates the length of an mp3 file without the usual length header (Xing, Info) and stops decoding
    there: if a large part of the file is left unread, it is ``broken_audio``, never a silently shorter song.
    """
    path = Path(path)
    samples, sample_rate = _decode(path)
    mono = _mean_of_channels(samples)
    _require_mix(path, samples, mono)
    del samples  # twice as large where there are two channels
    bad = np.flatnonzero(~np.isfinite(mono))
    if bad.size:
        raise DataError(
            "the audio has samples that are not finite",
            reason="nan",
            where=str(path),
            found=f"{bad.size} NaN or infinite samples, the first at {bad[0] / sample_rate:.3f} s",
            allowed="finite samples",
            fix="export the file again, for example as 16-bit wav",
        )
    return AudioSignal(np.ascontiguousarray(mono, dtype=np.float32), sample_rate)


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
    if n_channels > 1 and kept < LEAST_MIX:
        level = f"{10 * math.log10(kept):.0f} dB" if kept > 0 else "silent"
        raise DataError(
            "the channels are in antiphase: their mean, from which features are computed, has lost the music",
            reason="antiphase",
            where=str(path),
            found=f"a mix of {n_channels} channels, {level} relative to that of unrelated channels",
            allowed=f"{10 * math.log10(LEAST_MIX):.0f} dB or more",
            fix="export the file again as mono, or with the polarity of one channel inverted",
        )


def audio_length(path: Path | str) -> tuple[int, int]:
    """Length of a file without decoding it: exactly that of the signal of `load_audio`.

    Only the header is read, except for mp3: its header is an estimate (a factor of 2.5 off was seen), so the file is
    decoded as `load_audio` does and the samples are counted. It is decoded in one call: soundfile seeks after every
    one, and in a damaged mp3 file that leads to another place, so that blocks would repeat samples.

    Parameters
    ----------
    path
        As for `load_audio`.

    Returns
    -------
    n_samples, sample_rate : tuple[int, int]
        Samples per channel, and the sample rate in Hz.

    Raises
    ------
    DataError
        As `load_audio`, for what the header shows (a truncated flac file and NaN are only found by decoding).
    """
    path = Path(path)
    with _Opened(path) as sound:
        n_samples, sample_rate = int(sound.frames), int(sound.samplerate)
        if _is_mp3(sound):
            n_samples = len(sound.read(dtype="float32", always_2d=True))
    if n_samples == 0:
        raise _empty(path)
    return n_samples, sample_rate


def pcm16(samples: NDArray[np.float32]) -> NDArray[np.float32]:
    """Quantise as writing a 16-bit wav with soundfile and reading it again does.

    libsndfile (with clipping on, as in soundfile) scales to 32 bit, rounds, and keeps the upper 16 bits: that is
    floor(x * 32768), except that a value less than half a 32-bit step below a 16-bit step is rounded up to it.
    EDGE makes its window wavs this way; rounding to nearest instead changes MFCC by up to 0.26.

    Parameters
    ----------
    samples
        (n,) float32, full scale 1.

    Returns
    -------
    NDArray[np.float32]
        (n,) float32, multiples of 1 / 32768 in [-1, 1).
    """
    # Scaling by powers of two is exact in float32; rint rounds halves to even as libsndfile's lrintf does.
    full_scale = np.clip(np.asarray(samples, dtype=np.float32), -1, 1)
    steps = np.floor(np.rint(full_scale * np.float32(2**31)) / np.float32(2**16))
    quantised: NDArray[np.float32] = np.minimum(steps, 32767) / np.float32(32768)
    return quantised


def resample(samples: NDArray[np.float32], from_rate: int, to_rate: int) -> NDArray[np.float32]:
    """Resample as `librosa.load` does: soxr, quality HQ, zeros appended to the length of `resampled_length`.

    Parameters
    ----------
    samples
        (n,) float32 at `from_rate`.
    from_rate, to_rate
        Sample rates in Hz.

    Returns
    -------
    NDArray[np.float32]
        (m,) float32, m = `resampled_length(n, from_rate, to_rate)`; the same array if the rates are equal.
    """
    if from_rate == to_rate:
        return samples
    import soxr  # what librosa calls; importing librosa takes seconds

    output = soxr.resample(samples, from_rate, to_rate, quality="soxr_hq")
    resampled = np.zeros(resampled_length(len(samples), from_rate, to_rate), np.float32)
    resampled[: len(output)] = output[: len(resampled)]
    return resampled


def resampled_length(n_samples: int, from_rate: int, to_rate: int) -> int:
    """Count the samples that `resample` gives: ceil(n * to / from), in librosa's own floating point."""
    if from_rate == to_rate:
        return n_samples
    return math.ceil(n_samples * (float(to_rate) / from_rate))


class _Opened:
    """Context manager: an open `soundfile.SoundFile`; libsndfile's errors inside it become DataErrors."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> soundfile.SoundFile:
        import soundfile

        try:
            # A Python file object: file names in any script work on any system, and its position can be read.
            self._file = open_regular(self._path)
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
            raise DataError(
                "the audio file does not exist",
                reason="missing_file",
                where=str(self._path),
                found="a folder" if isinstance(error, IsADirectoryError) else "nothing",
                allowed="an audio file (wav, flac, ogg, mp3)",
            ) from error
        except OSError as error:
            raise _broken(self._path, str(error)) from error
        try:
            self._sound = soundfile.SoundFile(self._file)
        except (soundfile.LibsndfileError, TypeError) as error:
            self._file.close()
            # soundfile raises TypeError for files without a header (.raw), whose rate it needs as an argument.
            raise _broken(self._path, getattr(error, "error_string", str(error))) from error
        try:
            self._require_plausible()
        except DataError:
            self._sound.close()
            self._file.close()
            raise
        return self._sound

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        import soundfile

        try:
            if isinstance(error, soundfile.LibsndfileError):
                raise _broken(self._path, error.error_string) from error
            if error is None and _is_mp3(self._sound):
                self._require_read_to_the_end()
        finally:
            self._sound.close()
            self._file.close()

    def _require_plausible(self) -> None:
        """Refuse an implausible length or rate in the header: memory is allocated before any sample is read.

        A low rate makes a small file long, and so a large signal once it is resampled for the features.
        """
        rate, frames, channels = int(self._sound.samplerate), int(self._sound.frames), int(self._sound.channels)
        if not MIN_RATE <= rate <= MAX_RATE:
            raise _broken(
                self._path,
                f"a sample rate of {rate:,} Hz",
                allowed=f"{MIN_RATE:,} to {MAX_RATE:,} Hz",
                fix="export the file again at 44100 or 48000 Hz",
            )
        decoded, resampled = 4 * frames * channels, 4 * frames * FEATURE_RATE // rate
        size = os.fstat(self._file.fileno()).st_size
        if frames < 0 or max(decoded, resampled) > min(MAX_BYTES, max(BOMB_BYTES, BOMB_RATIO * size)):
            what = "once decoded" if decoded >= resampled else f"once resampled to {FEATURE_RATE:,} Hz"
            raise _broken(
                self._path,
                f"a header with {frames:,} samples in {channels} channels at {rate:,} Hz, "
                f"{max(decoded, resampled):,} bytes {what}, in a file of {size:,} bytes",
            )

    def _require_read_to_the_end(self) -> None:
        size = self._path.stat().st_size
        unread = size - self._file.tell()
        if unread > _MAX_UNREAD_MP3 * size:
            raise _broken(
                self._path,
                f"an mp3 header with a wrong length: decoding stopped with {unread} of {size} bytes unread",
            )


def _decode(path: Path) -> tuple[NDArray[np.float32], int]:
    """All samples, (n, channels) float32, and the rate."""
    with _Opened(path) as sound:
        samples: NDArray[np.float32] = sound.read(dtype="float32", always_2d=True)
        sample_rate = int(sound.samplerate)
        # The header of mp3 is an estimate; in other formats `audio_length` has returned its length.
        if 0 < len(samples) != sound.frames and not _is_mp3(sound):
            raise _broken(path, f"{len(samples):,} samples instead of the {sound.frames:,} in the header")
    if samples.shape[0] == 0:
        raise _empty(path)
    return samples, sample_rate


def _is_mp3(sound: soundfile.SoundFile) -> bool:
    return "MPEG" in str(sound.format) or "MPEG" in str(sound.subtype)


def _broken(
    path: Path,
    message: str,
    allowed: str = "a complete wav, flac, ogg or mp3 file",
    fix: str = "copy or export the file again, as wav if in doubt",
) -> DataError:
    # For an empty file libsndfile only reports an unknown format or a missing file.
    found = message.strip() if path.stat().st_size or not path.is_file() else "a file of 0 bytes"
    return DataError(
        "the audio file cannot be decoded",
        reason="broken_audio",
        where=str(path),
        found=found,
        allowed=allowed,
        fix=fix,
    )


def _empty(path: Path) -> DataError:
    return DataError(
        "the audio file has no samples",
        reason="empty_audio",
        where=str(path),
        found="0 samples",
        allowed="at least one sample",
        fix="copy or export the file again",
    )

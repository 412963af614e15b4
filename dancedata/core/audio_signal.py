"""One decoded, mono audio signal."""

from __future__ import annotations

import io
import math
import wave
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import require_finite
from dancedata.core.errors import UsageError
from dancedata.core.hashing import sha256_bytes

#: Audio files that are read, in order of preference: lossless formats first, last those that need ffmpeg.
AUDIO_SUFFIXES = (".wav", ".flac", ".mp3", ".ogg", ".opus", ".aiff", ".aif", ".m4a", ".aac", ".mp4")
#: Folders of music in a folder of motion.
MUSIC_FOLDERS = ("music", "wavs", "audio", "musics")


@dataclass(frozen=True, eq=False)
class AudioSignal:
    """Mono samples at a constant rate.

    Attributes
    ----------
    samples
        (n,) float32, read-only, full scale is 1.
    sample_rate
        Samples per second.
    findings
        What was noticed when a file was decoded, (kind of flag, value), see `core.quality.OF_MUSIC`.

    Raises
    ------
    UsageError, DataError
        For other shapes or a sample rate below 1; "nan" if a sample is not finite.
    """

    samples: npt.NDArray[np.float32]
    sample_rate: int
    findings: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        samples = np.array(self.samples, dtype=np.float32)
        if samples.ndim != 1:
            raise UsageError("an AudioSignal must be mono", found=f"shape {samples.shape}", allowed="(n,)")
        if self.sample_rate < 1:
            raise UsageError("a sample rate must be above 0", found=self.sample_rate)
        require_finite(samples, "the audio", "sample")
        samples.setflags(write=False)
        object.__setattr__(self, "samples", samples)

    def __repr__(self) -> str:
        seconds = self.n_samples / self.sample_rate
        return f"AudioSignal({self.n_samples} samples at {self.sample_rate} Hz, {seconds:.2f} s)"

    @property
    def n_samples(self) -> int:
        """Number of samples n."""
        return len(self.samples)

    @cached_property
    def sha256(self) -> str:
        """Hash of sample rate and samples, in any format of the file: of the hashes of quarters of a second."""
        step = max(1, self.sample_rate // 4)
        quarters = [self.samples[k : k + step].astype("<f4", copy=False) for k in range(0, self.n_samples, step)]
        hashes = " ".join(sha256_bytes(quarter.data) for quarter in quarters)
        return sha256_bytes(f"{self.sample_rate} {self.n_samples} {hashes}".encode())

    def part(self, start: int, stop: int) -> AudioSignal:
        """Return samples start .. stop - 1."""
        return AudioSignal(self.samples[start:stop], self.sample_rate)


def wav_bytes(pcm: npt.NDArray[np.int16], sample_rate: int) -> bytes:
    """Return samples (n, channels) as the bytes of a wav file, PCM 16."""
    stream = io.BytesIO()
    with wave.open(stream, "wb") as file:
        file.setnchannels(pcm.shape[1])
        file.setsampwidth(2)
        file.setframerate(sample_rate)
        file.writeframes(pcm.astype("<i2").tobytes())
    return stream.getvalue()


def pcm16(samples: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Quantise as writing a 16-bit wav with soundfile and reading it again does.

    libsndfile (with clipping on, as in soundfile) scales to 32 bit, rounds, and keeps the upper 16 bits: that is
    floor(x * 32768), except that a value less than half a 32-bit step below a 16-bit step is rounded up to it.
    EDGE makes its window wavs this way; rounding to nearest instead changes MFCC by up to 0.26.

    `samples`: (n,) float32, full scale 1.
    Returns: (n,) float32, multiples of 1 / 32768 in [-1, 1).
    """
    # Scaling by powers of two is exact in float32; rint rounds halves to even as libsndfile's lrintf does.
    full_scale = np.clip(np.asarray(samples, dtype=np.float32), -1, 1)
    steps = np.floor(np.rint(full_scale * np.float32(2**31)) / np.float32(2**16))
    quantised: npt.NDArray[np.float32] = np.minimum(steps, 32767) / np.float32(32768)
    return quantised


def resampled_length(n_samples: int, from_rate: int, to_rate: int) -> int:
    """Count the samples that `resample` gives: ceil(n * to / from), in librosa's own floating point."""
    if from_rate == to_rate:
        return n_samples
    return math.ceil(n_samples * (float(to_rate) / from_rate))

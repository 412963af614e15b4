"""Units of work on music: functions that worker processes run. Each takes and returns small, picklable things."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import Reject
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.packages import package_version
from dancedata.core.rejects import changed, reject_of
from dancedata.execution.arithmetic import expected
from dancedata.execution.cache import Cache
from dancedata.music.silence import Level, levels, without_sound

#: Raised by hand when the stage gives other numbers for the same input.
_SIGNAL_STAGE = 5


class SignalInfo(NamedTuple):
    """Facts about a decoded file, in the order of the cache's JSON array."""

    sha256: str
    sample_rate: int
    n_samples: int
    ffmpeg: str
    findings: list[tuple[str, float]]
    levels: list[Level]


@dataclass(frozen=True)
class SignalId:
    """The identity of an audio file's signal."""

    path: Path
    file: str  # its state, see `Cache.stat_key`
    sha256: str  # of the signal; of a stretched one, of what makes it
    sample_rate: int
    n_samples: int
    speed: Fraction = Fraction(1)
    decoded_sha256: str = ""  # of a stretched signal: that of the file's
    skipped: int = 0  # samples at the beginning, less than a row, that are left out
    ffmpeg: str = ""  # version that decoded the file; "" if libsndfile did
    findings: Sequence[tuple[str, float]] = field(default=(), compare=False, repr=False)  # see `AudioSignal`
    levels: Sequence[Level] = field(default=(), compare=False, repr=False)  # see `silence.levels`

    @classmethod
    def of(cls, path: Path, file: str, info: SignalInfo) -> SignalId:
        """Return the identity of the signal with these facts."""
        return cls(path, file, *info[:3], ffmpeg=info.ffmpeg, findings=info.findings, levels=info.levels)

    @classmethod
    def cached(cls, cache: Cache, path: Path) -> SignalId | None:
        """Return the cached result of `identify_audio`, None if there is none."""
        try:
            file = Cache.stat_key("signal", path)
        except FileNotFoundError:
            return None
        entry = _cached_info(cache, _signal_key(file))
        return None if entry is None else cls.of(path, file, entry)

    @cached_property
    def grid(self) -> FrameGrid:
        """The grid of the samples."""
        return FrameGrid.of(self.sample_rate)

    def at_speed(self, speed: Fraction) -> SignalId:
        """Return the same music `speed` times as fast; it is stretched when a feature is computed."""
        if speed == 1:
            return self
        from dancedata.music import stretch

        stretched_sha256 = Cache.key(
            "stretched",
            version=stretch.VERSION,
            signal=self.sha256,
            speed=str(speed),
            packages={name: package_version(name) for name in stretch.PACKAGES},
            arithmetic=expected(),
        )
        n_samples = stretch.stretched_length(self.n_samples, speed)
        return replace(self, sha256=stretched_sha256, n_samples=n_samples, speed=speed, decoded_sha256=self.sha256)

    def noted(self, start: Fraction, seconds: Fraction) -> list[tuple[str, float]]:
        """Return (kind of flag, value) of a part: where it has no sound, and what decoding noticed."""
        return [*without_sound(self.levels, start, seconds), *self.findings]

    def without(self, samples: int) -> SignalId:
        """Return the signal without some samples at its beginning."""
        if not samples:
            return self
        sha256 = Cache.key("skipped", signal=self.sha256, samples=samples)
        decoded, left = self.decoded_sha256 or self.sha256, max(0, self.n_samples - samples)
        return replace(self, sha256=sha256, n_samples=left, decoded_sha256=decoded, skipped=samples)

    def timeline(self, start: Fraction, grid: FrameGrid) -> tuple[SignalId, int]:
        """Return the signal whose rows lie on a clip's frames, and the row at frame 0, below 0 where music is later.

        Rows begin at the fraction of a row of `start`: rounding to a row would move music by up to half of one.
        """
        offset = math.floor(start * grid.rate)
        begun = (start - grid.seconds(offset)) * self.sample_rate
        return self.without(math.floor(begun + Fraction(1, 2))), offset

    def load(self) -> AudioSignal:
        """Decode the signal again; DataError "changed" if the file has changed, whose key would be the old one's."""
        from dancedata.music.signal import load_audio

        signal_of_file = load_audio(self.path)
        file = None
        with suppress(OSError):
            file = Cache.stat_key("signal", self.path)
        if file != self.file and signal_of_file.sha256 != (self.decoded_sha256 or self.sha256):
            raise changed(self.path)
        if self.speed != 1:
            from dancedata.music.stretch import stretched

            signal_of_file = stretched(signal_of_file, self.speed)
        if self.skipped:
            return replace(signal_of_file, samples=signal_of_file.samples[self.skipped :])
        return signal_of_file


def identify_audio(cache: Cache, path: Path) -> SignalId | Reject:
    """Decode a file and hash its samples; the result is cached until the file changes."""
    from dancedata.music.ffmpeg import ffmpeg_version
    from dancedata.music.signal import load_audio

    try:
        file = Cache.stat_key("signal", path)
        key = _signal_key(file)
        entry = _cached_info(cache, key)
        if entry is None:
            with cache.lock("signals", key):
                entry = _cached_info(cache, key)
                if entry is None:
                    signal = load_audio(path)
                    by = ffmpeg_version() if any(kind == "decoded_by_ffmpeg" for kind, _ in signal.findings) else ""
                    entry = SignalInfo(
                        signal.sha256, signal.sample_rate, signal.n_samples, by, [*signal.findings], levels(signal)
                    )
                    if Cache.stat_key("signal", path) != file:
                        raise changed(path)
                    cache.put_json("signals", key, entry)
    except DataError as error:
        return reject_of(error, file=path)
    except FileNotFoundError:
        return Reject("missing_music", file=str(path), detail=f"{path}: the file vanished during the build")
    return SignalId.of(path, file, entry)


def _cached_info(cache: Cache, key: str) -> SignalInfo | None:
    """Return cached facts; None if there are none, or if another version of ffmpeg decoded the file."""
    entry = cache.json("signals", key)
    info = None if entry is None else SignalInfo(*entry)
    if info is not None and info.ffmpeg:
        from dancedata.music.ffmpeg import ffmpeg_version  # finding it takes a process

        return info if info.ffmpeg == ffmpeg_version() else None
    return info


def _signal_key(file: str) -> str:
    packages = {"soundfile": package_version("soundfile"), "libsndfile": libsndfile_version()}
    return Cache.key("signal", version=_SIGNAL_STAGE, file=file, packages=packages)


@lru_cache(maxsize=1)
def libsndfile_version() -> str:
    """Return the version of the library that decodes music."""
    import soundfile

    return str(soundfile.__libsndfile_version__)

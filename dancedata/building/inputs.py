"""Songs and files of rows that takes are made of, as workers load them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from operator import attrgetter
from pathlib import Path
from typing import Any

from dancedata.building.signals import SignalId
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.quality import music_flags
from dancedata.core.rejects import require_same
from dancedata.execution.cache import Cache


@dataclass(frozen=True)
class Song:
    """A song that a worker decodes, with the beginning and the speed that `signal` states."""

    signal: SignalId

    key = property(attrgetter("signal.sha256"))
    path = property(attrgetter("signal.path"))

    def load(self) -> AudioSignal:
        """Decode it; DataError if the file has changed."""
        return self.signal.load()

    def check(self, cache: Cache) -> None:
        """Do nothing: `load` has compared the samples."""


@dataclass(frozen=True)
class RowsFile:
    """A file with rows of a field; `sha256` is "" where a plan has not read it."""

    path: Path
    sha256: str
    n_rows: int

    key = property(attrgetter("sha256"))

    def load(self) -> Path:
        """Return the path: fields read the rows, each in its way."""
        return self.path

    def check(self, cache: Cache) -> None:
        """Raise DataError if it has changed."""
        require_same(self.path, self.sha256, cache.file_sha256)


@dataclass(frozen=True)
class Music:
    """The music of a dancer."""

    signal: SignalId | None  # None where no field needs music
    start: Fraction = Fraction(0)  # second of the song at frame 0, exact
    bpm: float | None = None  # tempo; None if unknown
    name: str = ""
    excerpt: int | None = None  # number of the slice that the take is
    is_file: bool = True  # whether it is not stretched

    def at_speed(self, speed: Fraction, name: str) -> Music:
        """Return the music at a speed, under another name."""
        return replace(
            self,
            signal=self.signal and self.signal.at_speed(speed),
            start=self.start / speed,
            bpm=None if self.bpm is None else float(Fraction(self.bpm) * speed),
            name=name,
            is_file=False,
        )

    def flags(self, seconds: Fraction) -> list[dict[str, Any]]:
        """Return the flags of the music of a take of this length, as JSON."""
        if self.signal is None:
            return []
        return [flag.to_json() for flag in music_flags(self.signal.noted(self.start, seconds))]

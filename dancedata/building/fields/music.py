"""Features of music: of whole songs, or of slices of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.building.inputs import Music, Song
from dancedata.building.plugins import Ask, Field, Reach
from dancedata.building.result import Rows
from dancedata.building.signals import SignalId
from dancedata.building.take import Take
from dancedata.core.clip import Reject
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.grid import FrameGrid, WindowGrid, WindowSpec
from dancedata.core.packages import package_version
from dancedata.core.plugins import AudioFeature, Plugin
from dancedata.core.typing import override
from dancedata.execution.arithmetic import expected
from dancedata.execution.cache import Cache
from dancedata.files.documents import document_of

if TYPE_CHECKING:
    from dancedata.core.dance import MusicBeats
    from dancedata.store.stored_clip import AudioBlock

#: Raised by hand when the stage gives other numbers for the same input.
_STAGE = 3


@dataclass(frozen=True)
class FeatureField(Field):
    """Rows of an audio feature."""

    slot = "audio"
    stage: ClassVar[str] = "features"

    name: str  # type: ignore[misc]
    grid: FrameGrid
    feature: AudioFeature
    own_rate: bool = False  # whether `grid` was given for this field alone

    @property
    def kind(self) -> Literal["motion", "audio"]:  # type: ignore[override]
        """Motion for rows that describe the dancer, else audio."""
        return "motion" if self.feature.of_motion else "audio"

    columns = property(attrgetter("feature.columns"))
    dtype = property(attrgetter("feature.dtype"))
    codebook = property(attrgetter("feature.codebook"))
    packages = property(attrgetter("feature.packages"))
    about = property(attrgetter("feature.about"))

    @property
    @override
    def plugins(self) -> Mapping[str, Plugin]:
        return {f"audio {self.name}": self.feature}

    @override
    def resolved(self, hash_file: Callable[[Path], str]) -> FeatureField:
        return replace(self, feature=self.feature.resolved(hash_file))

    @override
    def document(self) -> dict[str, Any]:
        document = document_of(self.feature)
        return {**document, "fps": str(self.grid)} if self.own_rate else document


@dataclass(frozen=True)
class MusicField(FeatureField):
    """A feature of a song; of slices, each by itself, but those of a song in one call."""

    needs_music = True

    windows: WindowSpec | None = None  # slices whose rows are computed alone; None: whole songs
    arithmetic: str | None = None  # what computed the rows; None: `expected`

    @property
    @override
    def lane(self) -> str:
        return "" if self.feature.exact else self.name

    def beats(self, rows: npt.NDArray[Any]) -> MusicBeats:
        """Return the beats of rows (T, D), at their instants."""
        from dancedata.core.dance import MusicBeats

        return MusicBeats.of_rows(rows, self.columns, self.grid, late=self.feature.beat_rows_late)

    @property
    @override
    def batch(self) -> int:
        return self.feature.windows_per_call or super().batch

    @override
    def workers(self, jobs: int) -> int:
        return self.feature.workers(jobs)

    @property
    @override
    def sha256(self) -> str:
        return self.song_key(None, "")

    @property
    def unit(self) -> str:  # type: ignore[override]
        """What a result is of."""
        return "songs" if self.windows is None else "slices"

    @override
    def block(self, rows: Rows, take: Take, dancer: int, grid: FrameGrid) -> AudioBlock:
        from dancedata.store.stored_clip import AudioBlock  # workers need no h5py

        return AudioBlock(rows.key, rows.array, rows.offset)  # which clips share

    @override
    def asks(self, take: Take) -> Sequence[Ask]:
        return [self.ask(dancer.music) for dancer in take.dancers]

    def ask(self, music: Music) -> Ask:
        """Return what is asked of a song: its rows, or those of a slice."""
        signal = _signal(music)
        if music.excerpt is not None:
            return Ask(Song(signal), self.slice_key(music.bpm, signal, music.excerpt), (music.bpm, music.excerpt))
        signal, offset = signal.timeline(music.start, self.grid)
        return Ask(Song(signal), self.song_key(music.bpm, signal.sha256), (music.bpm, None), offset)

    def song_asks(self, music: Music) -> list[Ask]:
        """Return what is asked of a song: its rows, or those of all its slices."""
        if self.windows is None:
            return [self.ask(music)]
        signal = _signal(music)
        n_slices = len(self.slices(signal.n_samples, signal.sample_rate)[0])
        return [self.ask(replace(music, excerpt=number)) for number in range(n_slices)]

    def song_key(self, bpm: float | None, sha256: str) -> str:
        """Return the key of a song's rows, by the hash of its samples."""
        return Cache.key("track", common=self._key_at(bpm), signal=sha256)

    def slice_key(self, bpm: float | None, signal: SignalId, number: int) -> str:
        """Return the key of a slice's rows: its song and its place in it.

        Its samples are not enough: of what neighbouring slices share, equal ones of two songs differ by rounding.
        """
        start, rows = self._first_sample(number, signal.grid), self.slice_rows
        return Cache.key("window", common=self._key_at(bpm), signal=signal.sha256, start=start, rows=rows)

    @property
    def slice_grid(self) -> WindowSpec:
        """The slices; UsageError for a field of whole songs."""
        if self.windows is None:
            raise UsageError("a field of whole songs has no slices", where=self.name)
        return self.windows

    @property
    def slice_rows(self) -> int:
        """Rows of a slice."""
        return self.slice_grid.grid.rows_down(self.slice_grid.length, of=self.grid)

    def slices(self, n_samples: int, sample_rate: int) -> tuple[npt.NDArray[np.int64], int]:
        """Return the first samples (W,) of a signal's whole slices, and their length in samples.

        A slice starts at its exact time, rounded down. EDGE adds up a truncated stride, which drifts away from motion
        unless a stride is a whole number of samples, as 0.5 s at any even rate.
        """
        samples, windows = FrameGrid.of(sample_rate), self.slice_grid
        length = windows.grid.rows_down(windows.length, of=samples)
        if n_samples < length or length < 1:
            return np.empty(0, dtype=np.int64), length
        # A slice fits if it begins at a frame whose sample, rounded down, is at most n_samples - length.
        n_frames = samples.rows_up(n_samples - length + 1, of=windows.grid)
        count = WindowGrid(1, windows.stride).count(n_frames)
        return np.array([self._first_sample(k, samples) for k in range(count)], dtype=np.int64), length

    def _first_sample(self, number: int, samples: FrameGrid) -> int:
        return self.slice_grid.grid.rows_down(self.slice_grid.start(number), of=samples)

    @cached_property
    def _keys(self) -> dict[float | None, str]:
        return {}

    def _key_at(self, bpm: float | None) -> str:
        """Return the common part of keys, hashed once for each tempo."""
        feature = self.feature
        # Dropped from the key where the feature ignores it: equal music is then computed once.
        bpm = None if bpm is None or not feature.uses_tempo else float(bpm)
        if bpm not in self._keys:
            self._keys[bpm] = Cache.key(
                "feature",
                version=[_STAGE, feature.version],
                feature={self.name: document_of(feature)},
                fps=str(self.grid),
                excerpts=self.windows is not None,
                start_bpm=bpm,
                packages={name: package_version(name) for name in feature.packages},
                arithmetic=(self.arithmetic or expected()) if feature.exact else None,
            )
        return self._keys[bpm]

    @override
    def n_rows(self, take: Take, dancer: int) -> int:
        music = take.dancers[dancer].music
        if music.excerpt is not None:
            return self.slice_rows
        signal = _signal(music).timeline(music.start, self.grid)[0]
        return self.feature.n_rows(signal.n_samples, signal.sample_rate, self.grid)

    @override
    def reach(self, take: Take, dancer: int, grid: FrameGrid) -> Reach | Reject:
        music, ref = take.dancers[dancer].music, take.dancers[dancer].ref
        signal = _signal(music)
        path = ref.audio_path or ref.motion_path
        audio_s = round(signal.n_samples / signal.sample_rate, 3)
        beyond, reason = f"reaches beyond the end of {path.name}", "short_audio"
        short = f"{path}: the music is shorter than a window: {audio_s} s"
        if music.excerpt is not None:
            n_slices = len(self.slices(signal.n_samples, signal.sample_rate)[0])
            first, end = 0, take.time.frames_on(grid) if music.excerpt < n_slices else 0
            if n_slices:
                reason, short = "no_audio", f"{path}: the music ends before the slice does, after {audio_s} s"
        else:
            timeline, offset = signal.timeline(music.start, self.grid)
            rows = self.feature.n_rows(timeline.n_samples, timeline.sample_rate, self.grid)
            first = max(0, self.grid.rows_up(-offset, of=grid))
            end = self.grid.rows_down(rows - offset, of=grid)
            if music.start:
                beyond = f"is not within {path.name}, whose second {float(music.start):g} is frame 0"
        return Reach(first, end, "no_audio", reason, beyond, short, str(path), {"audio_s": audio_s})

    @override
    def make(self, loaded: Any, parts: Sequence[Any]) -> Sequence[npt.NDArray[Any]]:
        by_part: dict[Any, Any] = {}
        for bpm in dict.fromkeys(bpm for bpm, _ in parts):  # each tempo that is stated
            numbers = [number for of, number in parts if of == bpm and number is not None]
            if (bpm, None) in parts:
                by_part[bpm, None] = self.feature.extract(loaded, self.grid, start_bpm=bpm)
            if numbers:
                starts, length = self.slices(len(loaded.samples), loaded.sample_rate)
                rows = self.feature.extract_windows(
                    loaded, starts[np.array(numbers)], length, self.grid, self.slice_rows, start_bpm=bpm
                )
                by_part |= {(bpm, number): of_slice for number, of_slice in zip(numbers, rows, strict=True)}
        return [by_part[part] for part in parts]


def _signal(music: Music) -> SignalId:
    if music.signal is None:
        raise StoreError("a take without music reached the features of music", where=music.name)
    return music.signal

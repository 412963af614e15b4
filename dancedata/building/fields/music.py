"""Rows of a take's music."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.building.inputs import Music, Song
from dancedata.building.plugins import Ask, Field, Reach
from dancedata.building.result import Rows
from dancedata.building.signals import FeatureKeys, SignalId, timeline_of, window_samples
from dancedata.building.take import Take
from dancedata.core.clip import Reject
from dancedata.core.errors import StoreError
from dancedata.core.grid import FrameGrid
from dancedata.recipes.fields import FeatureJob

if TYPE_CHECKING:
    from dancedata.store.stored_clip import AudioBlock


@dataclass(frozen=True)
class MusicRows(Field):
    """A feature of a song; of slices, each by itself, but those of a song in one call.

    `arithmetic`: Instructions that computed the rows; None: those of this machine's builds, see `expected`.
    """

    stage: ClassVar[str] = "features"

    spec: FeatureJob
    arithmetic: str | None = None

    @property
    def lane(self) -> str:
        """Its name, if results of processors differ."""
        return "" if self.spec.feature.exact else self.name

    @property
    def batch(self) -> int:
        """Slices in a call."""
        return self.spec.feature.windows_per_call or super().batch

    @property
    def looks_ahead(self) -> bool:
        """Whether the next song is decoded while a device computes."""
        return self.spec.feature.prefetch

    def workers(self, jobs: int) -> int:
        """Return how many processes run its lane: of a network one for each card."""
        return self.spec.feature.workers(jobs)

    @property
    def sha256(self) -> str:
        """Hash of all that shapes the rows of a song, its tempo not known."""
        return self._keys.track(None, "")

    def block(self, rows: Rows, take: Take, dancer: int, grid: FrameGrid) -> tuple[AudioBlock, ...]:
        """Return the rows of the song, which clips share."""
        from dancedata.store.stored_clip import AudioBlock  # workers need no h5py

        return (AudioBlock(rows.key, rows.array, rows.offset),)

    def asks(self, take: Take) -> Sequence[Ask]:
        """Return what is asked for each dancer: the rows of his song, or of a slice of it."""
        return [self.ask(dancer.music) for dancer in take.dancers]

    def ask(self, music: Music) -> Ask:
        """Return what is asked of a song: its rows, or those of a slice."""
        signal = _signal(music)
        if music.excerpt is not None:
            key = self._keys.window(music.bpm, signal, music.excerpt)
            return Ask(Song(signal), key, (music.bpm, music.excerpt))
        signal, offset = timeline_of(signal, music.start, self.grid)
        return Ask(Song(signal), self._keys.track(music.bpm, signal.sha256), (music.bpm, None), offset)

    def slice_asks(self, music: Music) -> list[Ask]:
        """Return what is asked for all slices of a song."""
        signal = _signal(music)
        n_slices = len(window_samples(self.spec, signal.n_samples, signal.sample_rate)[0])
        return [self.ask(replace(music, excerpt=number)) for number in range(n_slices)]

    @cached_property
    def _keys(self) -> FeatureKeys:
        return FeatureKeys(self.spec, self.arithmetic)

    @property
    def needs_music(self) -> bool:
        """It is made of decoded music."""
        return True

    @property
    def unit(self) -> str:
        """What a result is of."""
        return "songs" if self.spec.windows is None else "slices"

    def n_rows(self, take: Take, dancer: int) -> int:
        """Return the number of rows of a song, or of a slice of it."""
        music = take.dancers[dancer].music
        if music.excerpt is not None:
            return self.spec.window_rows
        signal = timeline_of(_signal(music), music.start, self.grid)[0]
        return self.spec.feature.n_rows(signal.n_samples, signal.sample_rate, self.grid)

    def reach(self, take: Take, dancer: int, grid: FrameGrid) -> Reach | Reject:
        """Return the frames that rows of the song cover."""
        music, ref = take.dancers[dancer].music, take.dancers[dancer].ref
        signal = _signal(music)
        path = ref.audio_path or ref.motion_path
        audio_s = round(signal.n_samples / signal.sample_rate, 3)
        beyond, reason = f"reaches beyond the end of {path.name}", "short_audio"
        short = f"{path}: the music is shorter than a window: {audio_s} s"
        if music.excerpt is not None:
            n_slices = len(window_samples(self.spec, signal.n_samples, signal.sample_rate)[0])
            first, end = 0, take.time.frames_on(grid) if music.excerpt < n_slices else 0
            if n_slices:
                reason, short = "no_audio", f"{path}: the music ends before the slice does, after {audio_s} s"
        else:
            timeline, offset = timeline_of(signal, music.start, self.grid)
            rows = self.spec.feature.n_rows(timeline.n_samples, timeline.sample_rate, self.grid)
            first = max(0, self.grid.rows_up(-offset, of=grid))
            end = self.grid.rows_down(rows - offset, of=grid)
            if music.start:
                beyond = f"is not within {path.name}, whose second {float(music.start):g} is frame 0"
        return Reach(first, end, "no_audio", reason, beyond, short, str(path), {"audio_s": audio_s})

    def make(self, loaded: Any, parts: Sequence[Any]) -> Sequence[npt.NDArray[Any]]:
        """Compute the rows of a whole song, or of slices of it, for each tempo that is stated."""
        by_part: dict[Any, Any] = {}
        for bpm in dict.fromkeys(bpm for bpm, _ in parts):
            numbers = [number for of, number in parts if of == bpm and number is not None]
            if (bpm, None) in parts:
                by_part[bpm, None] = self.spec.feature.extract(loaded, self.grid, start_bpm=bpm)
            if numbers:
                starts, length = window_samples(self.spec, len(loaded.samples), loaded.sample_rate)
                rows = self.spec.feature.extract_windows(
                    loaded, starts[np.array(numbers)], length, self.grid, self.spec.window_rows, start_bpm=bpm
                )
                by_part |= {(bpm, number): of_slice for number, of_slice in zip(numbers, rows, strict=True)}
        return [by_part[part] for part in parts]


def _signal(music: Music) -> SignalId:
    if music.signal is None:
        raise StoreError("a take without music reached the features of music", where=music.name)
    return music.signal

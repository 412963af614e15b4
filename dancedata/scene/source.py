"""The source of a dataset: the music of its clips, and their original motion."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from dancedata.building.source_music import dataset_of
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.bodies import has_body, transfer
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DanceDataError, DataError
from dancedata.core.grid import FrameGrid
from dancedata.kernel import SourceMusic, Store, load_audio, resample
from dancedata.recipes.parse import stored_recipe
from dancedata.scene.figure import Figure
from dancedata.scene.scene_list import Item, Scene

#: Highest sample rate that a page gets, and most seconds.
MAX_RATE, MAX_SECONDS = 48_000, 600.0


@dataclass(frozen=True, eq=False)
class ClipSound:
    """The music of an item: mono, exactly as long as it, silent where the music has ended; and notes on it."""

    signal: AudioSignal
    notes: tuple[str, ...] = ()


class Sounds(Protocol):
    """Music of items."""

    def sound(self, item: Item) -> ClipSound | None:
        """Return the music of an item; None without any. DataError if it cannot be decoded."""


class ClipSource:
    """The folder that a dataset was built from, or one with audio files that have the names of its clips or songs.

    Raises SourceError: if the folder does not exist.
    """

    def __init__(self, store: Store, folder: Path) -> None:
        self.store, self.folder = store, folder
        self.music = SourceMusic.of(store, folder)

    def sound(self, item: Item) -> ClipSound | None:
        """Return the music of an item; None without any. DataError if it cannot be decoded."""
        clip = self.store[item.clip.id]
        if clip.id not in self.music.files:
            return None
        notes = []
        try:
            signal = self.music.load(clip)
        except DataError as error:
            if error.reason != "other_music":
                raise
            signal = load_audio(self.music.files[clip.id])
            notes.append("this music is not the music that the dataset was built from")
        signal = self._at_speed(item, signal)
        begin = clip.audio_start + self.store.grid.seconds(item.start)
        seconds = self.store.grid.seconds(item.n_frames)
        if seconds > MAX_SECONDS:
            notes.append(f"only the first {MAX_SECONDS / 60:.0f} minutes have music")
            seconds = Fraction(MAX_SECONDS)
        return ClipSound(cut(signal, begin, seconds), tuple(notes))

    def original(self, scene: Scene, item: Item) -> Figure:
        """Read the motion of an item from the source, on the body and at the rate of the figure of its scene."""
        figure = scene.figure
        ref = self._refs.get(item.clip.slice_of or item.clip.id)
        reader = dataset_of(self.store)
        if figure is None or ref is None or reader is None:
            origin = ": it is a copy of another clip" if item.clip.source else ""
            raise DataError(f"the source has no motion of this clip{origin}", reason="missing_file",
                            where=self.folder)  # fmt: skip
        motion = reader.load(ref).resampled(figure.grid)
        if has_body(motion.skeleton) and has_body(figure.skeleton):
            motion = transfer(motion, figure.skeleton)
        whole = replace(Figure.of_joints(motion.joints(), motion.skeleton, motion.grid), rotations=motion.rotations)
        first = item.clip.slice_start + item.start
        return whole.part(float(self.store.grid.seconds(first)), scene.seconds)

    def _at_speed(self, item: Item, signal: AudioSignal) -> AudioSignal:
        """Return the music of a copy at another tempo, stretched as the build did."""
        if not item.clip.source:
            return signal
        recipe = stored_recipe(self.store)
        spec = next((s for s in recipe.augment if s.clip_id(item.clip.source) == item.clip.id), None)
        if spec is None:
            return signal
        speed = spec.speed_of(self.store[item.clip.source].group or item.clip.source)
        if speed == 1:
            return signal
        from dancedata.music.stretch import stretched

        return stretched(signal, speed)

    @cached_property
    def _refs(self) -> dict[str, ClipRef]:
        reader = dataset_of(self.store)
        if reader is None:
            return {}
        try:
            return {ref.id: ref for ref in reader.scan(self.folder).clips}
        except DanceDataError:
            return {}  # a folder with music alone


def cut(signal: AudioSignal, begin: Fraction, seconds: Fraction) -> AudioSignal:
    """Return a part of a signal, with silence before it begins and after it has ended."""
    grid = FrameGrid.of(signal.sample_rate)
    first, count = math.floor(begin * grid.rate), grid.frames_up(seconds)
    samples, lead = np.zeros(count, dtype=np.float32), max(0, -first)
    available = signal.samples[max(0, first) : max(0, first + count)]
    samples[lead : lead + len(available)] = available
    return AudioSignal(samples, signal.sample_rate)


def flac(signal: AudioSignal) -> bytes:
    """Encode a signal as FLAC, 16 bits, at most 48 kHz: decoding returns each sample at its instant."""
    import soundfile

    rate = min(signal.sample_rate, MAX_RATE)
    samples = np.clip(resample(signal.samples, signal.sample_rate, rate), -1, 1)
    data = io.BytesIO()
    soundfile.write(data, samples, rate, format="FLAC", subtype="PCM_16")
    return data.getvalue()

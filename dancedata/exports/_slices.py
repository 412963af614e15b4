"""Five-second slices in EDGE's folders: their names, order, motion and sound."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal, pcm16, wav_bytes
from dancedata.core.clip import slice_name
from dancedata.core.grid import FrameGrid, WindowGrid
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.exports.base.job import Export, ExportJob, Missing
from dancedata.exports.base.needs import needs_field, needs_fps, needs_music, needs_splits

if TYPE_CHECKING:
    from dancedata.core.clip import Window
    from dancedata.core.motion import Motion
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip


FOLDERS = ("motions_sliced", "wavs_sliced", "jukebox_feats")
Sound = Literal["cut", "silence"]


@dataclass(frozen=True)
class SliceExport(Export):
    """Base of exports of EDGE's folders.

    Attributes
    ----------
    feature
        Audio feature to write, of 35 or 4800 columns.
    sound
        ``cut``: wavs cut from the music of --music. ``silence``: silent wavs, without a source; training does not
        use them, only rendering does.
    """

    recipe: ClassVar[Mapping[str, Any]] = {"motion": {"edge151": {}}, "audio": {"librosa35": {}}}
    listed_folders: ClassVar[tuple[str, ...]] = tuple(
        f"{part}/{name}" for part in ("train", "test") for name in FOLDERS
    )

    feature: str = "librosa35"
    sound: Sound = "cut"

    @override
    def guide_values(self, job: ExportJob) -> Mapping[str, object]:
        width = job.store.fields[self.feature].width
        kind = _WIDTHS[width]
        again = ", and once more in `baseline_feats`" if kind == "baseline" else ""
        return {"kind": kind, "width": width, "again": again}


@dataclass(frozen=True)
class SliceWriter:
    """Writes the slices of a dataset.

    `repeat`: How often each frame is in a pickle: 2 where the loader keeps every second one.
    `batch`: Batch size of the trainer, whose loaders drop the last, smaller batch.
    `place`: Puts a motion into the trainer's axes, from +Y up; None: these are its own.
    """

    job: ExportJob
    folder: AtomicFolder
    feature: str
    sound: Sound
    repeat: int
    batch: int
    place: Callable[[Motion], Motion] | None = None

    def write(self, part: str, splits: Sequence[str]) -> tuple[list[Slice], dict[str, npt.NDArray[np.float32]]]:
        """Write the folders of a part, "train" or "test"; return its slices and their motion at 30 per second."""
        slices = [item for split in splits for item in slices_of(self.job, split, self.feature)]
        slices.sort(key=lambda item: f"{item.name}.")  # as text, slice10 before slice2, as EDGE's loader
        _note_rejects(self.job, splits, self.folder)
        if self.sound == "cut":
            slices = with_whole_sound(self.job, slices, self.folder)
        for name in FOLDERS:
            self.folder.make_folder(f"{part}/{name}")
        if len(slices) < self.batch:
            self.folder.note(
                f"{part} has {counted(len(slices), 'window')}, fewer than the trainer's batch of {self.batch}, and "
                "its loaders drop smaller batches: pass a smaller --batch_size"
            )
        motion = self._write_motion(part, slices)
        self._write_features(part, slices)
        self._write_sounds(part, slices)
        return slices, motion

    def _write_motion(self, part: str, slices: list[Slice]) -> dict[str, npt.NDArray[np.float32]]:
        whole = {  # metres and axis-angle
            "pos": np.empty((len(slices), LENGTH, 3), np.float32),
            "q": np.empty((len(slices), LENGTH, 72), np.float32),
        }
        for number, item in enumerate(self.job.each(f"{part}: motion", slices)):
            rows = self.job.store.read(item.window, MOTION)
            motion = REPRESENTATIONS.get(MOTION)().decode(rows, FrameGrid.of(FPS))
            motion = motion if self.place is None else self.place(motion)
            whole["pos"][number] = motion.translation
            whole["q"][number] = motion.rotations.reshape(LENGTH, -1)
            repeated = {key: np.repeat(array[number], self.repeat, axis=0) for key, array in whole.items()}
            self.folder.write_pickle(f"{part}/motions_sliced/{item.name}.pkl", repeated)
        return whole

    def _write_features(self, part: str, slices: list[Slice]) -> None:
        names = ["jukebox_feats"]
        if _WIDTHS[self.job.store.fields[self.feature].width] == "baseline":
            names.append("baseline_feats")
        for item in self.job.each(f"{part}: {self.feature}", slices):
            rows = self.job.store.read(item.window, self.feature).astype(np.float32)
            for name in names:
                self.folder.write_npy(f"{part}/{name}/{item.name}.npy", rows)

    def _write_sounds(self, part: str, slices: list[Slice]) -> None:
        if self.sound == "silence":
            self.folder.note("the wavs are silent: training does not use them, rendered videos have no music")
            silent = quantised_wav(AudioSignal(np.zeros(LENGTH_S * _SILENCE_RATE, np.float32), _SILENCE_RATE))
            for item in slices:
                self.folder.write_bytes(f"{part}/wavs_sliced/{item.name}.wav", silent)
            return
        for item, sound in cut_sounds(self.job, slices):
            self.folder.write_bytes(f"{part}/wavs_sliced/{item.name}.wav", quantised_wav(sound))


MOTION = "edge151"
FPS, LENGTH, STRIDE = 30, 150, 15
LENGTH_S, STRIDE_S = 5, Fraction(1, 2)
#: Columns of EDGE's two features: librosa ("baseline") and Jukebox.
_WIDTHS = {35: "baseline", 4800: "jukebox"}
_SILENCE_RATE = 16_000


@dataclass(frozen=True)
class Slice:
    """A window of a clip, or a clip that is a slice, under its name in EDGE's files."""

    name: str
    clip: Clip
    window: Window

    @property
    def number(self) -> int:
        """Number of the window among all those of its clip, or of the clip that it is a slice of."""
        return WindowGrid(LENGTH, STRIDE).number(self.clip.slice_start + self.window.start)


def needs_slices(job: ExportJob, feature: str, splits: Sequence[str], *, sound: bool) -> list[Missing]:
    """Check that a dataset has all that slices need."""
    missing = needs_fps(job, FPS) + needs_field(job, MOTION, kind="motion", width=151, rate=FPS)
    missing += needs_field(job, feature, kind="audio", rate=FPS)
    if feature in job.store.fields and job.store.fields[feature].width not in _WIDTHS:
        width, fix = job.store.fields[feature].width, "audio: {librosa35: {}}, and --set feature=librosa35"
        missing.append(Missing(f"{feature} has {width} columns, not 35 or 4800", fix))
    slices = [clip for clip in job.clips() if clip.slice_of] if not missing else []
    odd = next((c for c in slices if c.n_frames != LENGTH or c.slice_start % STRIDE), None)
    if odd is not None:
        stored = f"slices of {odd.n_frames} frames, one from frame {odd.slice_start}, not of {LENGTH} every {STRIDE}"
        missing.append(Missing(f"the dataset has {stored}", "transforms: [slices], or none"))
    missing += needs_splits(job, *splits)
    if set("*?[") & set(str(job.out)):
        problem = "the loader lists folders by patterns, in which * ? [ have a meaning"
        missing.append(Missing(problem, "another --out"))
    if not missing:
        empty = [split for split in splits if not slices_of(job, split, feature)]
        missing += [Missing(f"{split} has no window of five seconds", "longer clips") for split in empty]
    if not sound:
        return missing
    missing += needs_music(job, job.clips(*splits))
    return missing or _needs_sound(job, feature, splits)


def _needs_sound(job: ExportJob, feature: str, splits: Sequence[str]) -> list[Missing]:
    silent = [split for split in splits if len(_short(job, slices := slices_of(job, split, feature))) == len(slices)]
    return [Missing(f"{split} has no window with five seconds of music", "longer music") for split in silent]


def slices_of(job: ExportJob, split: str, feature: str) -> list[Slice]:
    """Return the slices of a split."""
    clips = {clip.id: clip for clip in job.clips(split)}
    windows = job.store.windows(split, length=LENGTH, stride=STRIDE, fields=(MOTION, feature))
    pairs = [(clips[window.clip], window) for window in windows]
    return [Slice(c.id if c.slice_of else slice_name(c.id, w.start // STRIDE), c, w) for c, w in pairs]


def _note_rejects(job: ExportJob, splits: Sequence[str], folder: AtomicFolder) -> None:
    """Note the windows of splits that the dataset has left out: the trainer's own scripts would have them."""
    windows = job.store.info["windows"]
    if job.store.slice_length is None and (windows["length"], windows["stride"]) != (LENGTH, STRIDE):
        return
    clips = {clip.slice_of or clip.id for clip in job.clips(*splits)}
    names = []
    for row in job.store.rejects:
        clip, _, number = str(row.get("clip")).rpartition("_slice")
        if job.store.slice_length is not None and clip in clips and number.isdecimal():
            names.append(f"{row['clip']} ({row.get('reason')})")
        elif row.get("clip") in clips and isinstance(row.get("window"), int):
            names.append(f"{row['clip']} from frame {row['window']} ({row.get('reason')})")
    if names:
        folder.note(f"{counted(len(names), 'window')} that the dataset has left out: {listed(names)}")


def with_whole_sound(job: ExportJob, slices: list[Slice], folder: AtomicFolder) -> list[Slice]:
    """Return the slices whose five seconds of sound exist in full, as EDGE counts them; the others are noted."""
    short = _short(job, slices)
    if short:
        folder.note(
            f"{counted(len(short), 'window')} left out, whose music ends before five seconds of samples, as in EDGE: "
            f"{listed(short)}"
        )
    return [item for item in slices if item.name not in set(short)]


def _short(job: ExportJob, slices: list[Slice]) -> list[str]:
    """Return the names of slices whose music ends too early; DataError where it is not the dataset's music."""
    lengths = {name: job.music.length(clip) for name, clip in {s.clip.original: s.clip for s in slices}.items()}
    short: list[Slice] = []
    for item in slices:
        n_samples, rate = lengths[item.clip.original]
        if _first_sample(item, rate) + LENGTH_S * rate > n_samples:
            if item.clip.original not in {shorter.clip.original for shorter in short}:
                job.music.load(item.clip)  # a damaged copy is short as well
            short.append(item)
    return [item.name for item in short]


def cut_sounds(job: ExportJob, slices: list[Slice]) -> Iterator[tuple[Slice, AudioSignal]]:
    """Cut the sound of slices; each song is decoded once per clip."""
    clip, signal = "", None
    for item in slices:
        if item.clip.original != clip or signal is None:
            clip, signal = item.clip.original, job.music.load(item.clip)
        first = _first_sample(item, signal.sample_rate)
        yield item, signal.part(first, first + LENGTH_S * signal.sample_rate)


def quantised_wav(signal: AudioSignal) -> bytes:
    """Return a signal as a 16-bit mono wav, quantised as soundfile does it."""
    steps = (pcm16(signal.samples) * np.float32(32768)).astype(np.int16)
    return wav_bytes(steps[:, None], signal.sample_rate)


def _first_sample(item: Slice, rate: int) -> int:
    # EDGE adds up a stride that is truncated to samples.
    start = item.clip.audio_start - Fraction(item.clip.slice_start, FPS)
    begin = math.floor(start * rate + Fraction(1, 2))
    return begin + item.number * int(STRIDE_S * rate)

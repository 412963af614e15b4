"""Bailando and Bailando++: JSON files of positions, rotations and 438 columns of music."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import AudioFeature
from dancedata.core.registry import FEATURES
from dancedata.core.text import counted, listed, shown
from dancedata.core.typing import override
from dancedata.exports._aist import PARTS, is_ignored, needs_aist_names, note_ignored
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing
from dancedata.exports.base.needs import needs_field, needs_music, needs_music_from_start, needs_splits

if TYPE_CHECKING:
    from dancedata.core.audio_signal import AudioSignal
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip


def _find_songs(job: ExportJob, clips: list[Clip]) -> tuple[dict[str, Clip], list[Missing]]:
    """Return the clip with the longest signal of each song, and what is missing: other signals must begin it."""
    songs: dict[str, Clip] = {}
    missing: list[Missing] = []
    by_music: dict[str, list[Clip]] = {}
    for clip in clips:
        by_music.setdefault(clip.music, []).append(clip)
    for music, of_song in sorted(by_music.items()):
        different = list(
            {job.music.hashes.get(clip.id, str(job.music.files[clip.id])): clip for clip in of_song}.values()
        )
        signals = [job.music.load(clip) for clip in different] if len(different) > 1 else []
        longest = max(range(len(different)), key=lambda k: signals[k].n_samples) if signals else 0
        songs[music] = different[longest]
        unlike = [different[k] for k, s in enumerate(signals) if not _begins(s, signals[longest])]
        if unlike:
            problem = (
                f"one file per song is read, and the music {shown(music)} of {shown(unlike[0].id)} is not the "
                f"beginning of that of {shown(songs[music].id)}"
            )
            missing.append(Missing(problem, "a source with one audio file per song, as the official AIST++ has"))
    return songs, missing


def _begins(part: AudioSignal, whole: AudioSignal) -> bool:
    return part.sample_rate == whole.sample_rate and np.array_equal(part.samples, whole.samples[: part.n_samples])


def json_of(name: str, arrays: Mapping[str, npt.NDArray[np.float32]]) -> bytes:
    """Return ``{"id": name, KEY: rows, ...}``: nine digits, which give back every float32."""
    parts = [f'"id": {json.dumps(name)}', *(f'"{key}": {"".join(_rows(rows))}' for key, rows in arrays.items())]
    return f"{{{', '.join(parts)}}}\n".encode()


def _rows(rows: npt.NDArray[np.float32]) -> Iterator[str]:
    # Whole numbers alone would be read as an array of integers.
    digits = "%.1f" if np.array_equal(rows, np.trunc(rows)) else "%.9g"
    line = f"[{','.join([digits] * rows.shape[1])}]"
    yield "["
    for number, row in enumerate(rows.tolist()):
        yield f",\n{line % tuple(row)}" if number else line % tuple(row)
    yield "]"


_MOTION, _ROTATIONS, _FEATURE, _RATE = "bailando72", "fact219", "bailando438", 60
_SLOW = FrameGrid(Fraction(15, 2))
#: Frames of a window in both steps: a shorter sequence gives none.
_LEAST = 240
_TRAIN, _TEST = "data/aistpp_train_wav", "data/aistpp_test_full_wav"
_FOLDERS = {"train": _TRAIN, "test": _TEST}
_MUSIC, _MUSIC_60 = "data/aistpp_music_feat_7.5fps", "data/aistpp_music_feat_60fps"
_GUIDE = """## Train

The configurations look for `data/` below the working folder. In a checkout of Bailando (PyYAML below 6, numpy below
1.24):

```sh
ln -s {out}/data data
sh srun.sh configs/sep_vqvae.yaml train YOUR_NODE 1  # steps 1 to 4 as in its README
```

- `{train}/` and `{test}/`: 24 positions, metres, +Y up, 60 frames per second, with 438 columns of music. In
  train both end together, in test the music goes on to the end of the song. Test holds test and val, as in Bailando.
- `{music}/` and `{music_60}/`: the music of each song at 7.5 and 60 rows per second. The loaders find it by the
  second last part of a sequence's name. At 7.5 the envelope, beats and tempogram are zero in every row, as in the
  published recipe, unless the feature has `onset_fmax: nyquist`.
- Positions are those of the body that the dataset was built with, the published ones are SMPL's male body's:
  limbs differ by up to a few centimetres.
- {ignored}
- Bailando++ reads `{train}_rotmat/` and `{test}_rotmat/` as well: 219 columns, translation and 24
  matrices.{rotations}
- Windows are made in memory as float64: all of AIST++ takes some 2 GB, and 5 GB of text on disk.
"""


@EXPORTS.register("bailando")
@dataclass(frozen=True)
class Bailando(Export):
    """Bailando's JSON folders of sequences and songs, and those of Bailando++ (Siyao et al. 2022, 2023).

    Attributes
    ----------
    feature
        Field with the 438 columns at 60 rows per second; those at 7.5 are computed by the same feature.
    keep_ignored
        Keep the clips of the ignore list: Bailando's script means to remove them, but its command lacks the ending of
        their names, so its training set has them.
    """

    recipe: ClassVar[Mapping[str, Any]] = {
        "fps": _RATE,
        "windows": {"length_frames": 240, "stride_frames": 40},
        "motion": {_MOTION: {}, _ROTATIONS: {}},
        "audio": {_FEATURE: {}},
    }
    reference: ClassVar[str] = "lisiyao21/Bailando, commit cc90b98, utils/functional.py"
    guide_text: ClassVar[str] = _GUIDE
    listed_folders: ClassVar[tuple[str, ...]] = (_TRAIN, _TEST, _MUSIC, _MUSIC_60)

    feature: str = _FEATURE
    keep_ignored: bool = False

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        missing = needs_field(job, _MOTION, kind="motion", width=72, rate=_RATE)
        missing += needs_field(job, self.feature, kind="audio", width=438, rate=_RATE)
        missing += needs_splits(job, "train", "test")
        clips = [clip for part in PARTS for clip in self._clips(job, part)]
        missing += needs_aist_names(job, clips) + self._needs_ignored(job)
        missing += needs_music(job, clips)
        if missing:
            return missing
        if all(len(clip.read(_MOTION)) < _LEAST for clip in self._clips(job, "train")):
            missing.append(
                Missing(f"no sequence of train has {_LEAST} frames: loaders stop without one", "longer clips")
            )
        return missing + needs_music_from_start(clips, exactly=True) + _find_songs(job, clips)[1]

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        if not self.keep_ignored:
            note_ignored(folder, job.clips())
        for part in PARTS:
            clips = self._clips(job, part)
            for clip in job.each(part, clips):
                self._write_sequence(job, folder, part, clip)
            short = [clip.id for clip in clips if len(clip.read(_MOTION)) < _LEAST]
            if short:
                folder.note(
                    f"{counted(len(short), 'sequence')} of {part} shorter than {_LEAST} frames, which give no "
                    f"training window: {listed(short)}"
                )
        from dancedata.kernel import unit_runner

        songs, _ = _find_songs(job, [clip for part in PARTS for clip in self._clips(job, part)])
        feature = _feature_of(job, self.feature)
        compute = unit_runner(feature.exact)
        for music, clip in job.each("songs at 7.5 rows per second", list(songs.items())):
            folder.write_bytes(
                f"{_MUSIC_60}/{music}.json", json_of(music, {"music_array": clip.read_song(self.feature)})
            )
            slow = compute(feature.extract, job.music.load(clip), _SLOW)
            folder.write_bytes(f"{_MUSIC}/{music}.json", json_of(music, {"music_array": slow}))
        if _ROTATIONS not in job.store.fields:
            folder.note(f"without Bailando++'s rotations: they need motion: {{{_ROTATIONS}: {{}}}}")

    @override
    def guide_values(self, job: ExportJob) -> Mapping[str, object]:
        ignored = (
            "Clips of the ignore list are kept, as in the paper's training set."
            if self.keep_ignored
            else "Clips of the ignore list are left out. The paper's training set has them: `--set keep_ignored=true`"
        )
        rotations = "" if _ROTATIONS in job.store.fields else " They are not here."
        places = {"train": _TRAIN, "test": _TEST, "music": _MUSIC, "music_60": _MUSIC_60}
        return {**places, "ignored": ignored, "rotations": rotations}

    def _clips(self, job: ExportJob, part: str) -> list[Clip]:
        return [clip for clip in job.clips(*PARTS[part]) if self.keep_ignored or not is_ignored(clip)]

    def _needs_ignored(self, job: ExportJob) -> list[Missing]:
        """Return the clips of the ignore list that the dataset itself has left out."""
        if not self.keep_ignored:
            return []
        absent = [str(row.get("clip")) for row in job.store.rejects if row.get("reason") == "ignored"]
        fix = "dataset: {aist++: {ignore: none}}"
        return [Missing(f"clips of the ignore list are not in the dataset: {listed(absent)}", fix)] if absent else []

    def _write_sequence(self, job: ExportJob, folder: AtomicFolder, part: str, clip: Clip) -> None:
        music = clip.read_song(self.feature) if part == "test" else clip.read(self.feature)
        for field, ending in ((_MOTION, ""), (_ROTATIONS, "_rotmat")):
            if field in job.store.fields:
                dance = clip.read(field)
                rows = min(len(dance), len(music)) if part == "train" else None
                arrays: dict[str, npt.NDArray[np.float32]] = {
                    "music_array": music[:rows],
                    "dance_array": dance[:rows],
                }
                folder.write_bytes(f"{_FOLDERS[part]}{ending}/{clip.id}.json", json_of(clip.id, arrays))


def _feature_of(job: ExportJob, name: str) -> AudioFeature:
    """Return the audio feature of a field, with the parameters that the dataset was built with."""
    from dancedata.kernel import make_named

    recipe = job.store.info.get("recipe")
    audio = recipe.get("audio") if isinstance(recipe, Mapping) else None
    parameters = dict(audio[name]) if isinstance(audio, Mapping) and isinstance(audio.get(name), Mapping) else {}
    parameters.pop("fps", None)
    return make_named(FEATURES, "audio", _FEATURE, parameters)

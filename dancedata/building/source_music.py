"""The music of a built dataset, looked up in a folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Self

from dancedata.building.source_record import DIGITS, SourceRecord
from dancedata.core.audio_signal import AUDIO_SUFFIXES, AudioSignal
from dancedata.core.errors import DanceDataError, DataError, SourceError, UsageError
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.text import shown
from dancedata.files.listing import MANIFESTS, MOTION_FOLDERS
from dancedata.files.regular_file import sha256_file
from dancedata.music.signal import audio_length, load_audio
from dancedata.recipes.plugins import single_plugin
from dancedata.store import Clip, Store
from dancedata.store.songs import music_hashes

#: Most files of a folder whose hashes are compared.
_COMPARED = 4


@dataclass(frozen=True)
class SourceMusic:
    """Audio files of clips, in a folder."""

    folder: Path
    files: Mapping[str, Path]  # by the clip's id; copies of clips have that of their clip
    hashes: Mapping[str, str]  # beginnings of those of samples, as recorded

    @classmethod
    def of(cls, store: Store, source: Path | None) -> Self:
        """Find the music of a dataset's clips: files that its reader lists, else those with their names."""
        if source is None:
            raise UsageError("the music is needed", fix="name the folder with it: --music DIR, or source=DIR")
        if not source.is_dir():
            raise SourceError("the folder of the music does not exist", where=source)
        originals = [clip for clip in store if not clip.source]
        recordings = _listed(store, source) or _named(originals, source)
        files = {clip.id: recordings[clip.original] for clip in store if clip.original in recordings}
        return cls(source, files, music_hashes(store))

    def missing(self, clips: list[Clip]) -> list[str]:
        """Return the songs, or clips whose song has no name, that have no audio file."""
        return sorted({clip.music or clip.id for clip in clips if clip.id not in self.files})

    def length(self, clip: Clip) -> tuple[int, int]:
        """Return the number of samples and the sample rate of a clip's music, without decoding it."""
        return audio_length(self.files[clip.id])

    def load(self, clip: Clip) -> AudioSignal:
        """Decode a clip's music; DataError if it cannot be decoded, or does not match the dataset."""
        path = self.files[clip.id]
        signal = load_audio(path)
        expected = self.hashes.get(clip.source or clip.id)
        if expected is not None and signal.sha256[:DIGITS] != expected:
            raise DataError("this music does not match the dataset", reason="other_music", where=path,
                            found=f"samples with the hash {signal.sha256[:DIGITS]}",
                            allowed=f"{expected}, the music of clip {shown(clip.id)}",
                            fix="name the source of the dataset, or build it again from this one")  # fmt: skip
        return signal


def is_source(store: Store, folder: Path) -> bool:
    """Return whether a folder has motion files of a dataset's source, by their names and hashes."""
    clips = SourceRecord.of_store(store).clips or {}
    places = [folder, *(folder / name for name in MOTION_FOLDERS)]
    try:
        if any((folder / name).is_file() for name in MANIFESTS):
            places += [path for path in folder.iterdir() if path.is_dir()]
        for place in filter(Path.is_dir, places):
            named = (path for path in place.iterdir() if path.stem in clips and path.is_file())
            if any(sha256_file(p)[:DIGITS] == clips[p.stem][:DIGITS] for p in islice(named, _COMPARED)):
                return True
    except OSError:
        pass  # a folder above that may not be listed
    return False


def _listed(store: Store, source: Path) -> dict[str, Path]:
    """Return the audio files that the dataset's reader lists; nothing where it cannot read the folder."""
    reader = dataset_of(store)
    if reader is None or not any(source.iterdir()):  # a reader that generates its source would fill an empty folder
        return {}
    try:
        return {clip.id: clip.audio_path for clip in reader.scan(source).clips if clip.audio_path is not None}
    except DanceDataError:
        return {}


def dataset_of(store: Store) -> Dataset | None:
    """Return the reader of a store's source, with its recipe's parameters; None if it is unknown."""
    recipe = store.info.get("recipe")
    dataset = recipe.get("dataset") if isinstance(recipe, Mapping) else None
    return single_plugin(DATASETS, "dataset", dataset, []) if isinstance(dataset, Mapping) else None


def _named(clips: list[Clip], source: Path) -> dict[str, Path]:
    """Return files that have the name of a clip, or else of its song."""
    files: dict[str, Path] = {}
    for path in sorted(p for p in source.rglob("*") if p.suffix.lower() in AUDIO_SUFFIXES and p.is_file()):
        other = files.setdefault(path.stem, path)
        files[path.stem] = min(other, path, key=lambda p: AUDIO_SUFFIXES.index(p.suffix.lower()))
    by_clip = {clip.original: files.get(clip.original) or files.get(clip.music) for clip in clips}
    return {clip: path for clip, path in by_clip.items() if path is not None}

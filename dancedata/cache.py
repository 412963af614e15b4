"""Features of songs for training jobs. Each is computed once for all processes.

`FeatureCache` is the cache that builds use, with the same keys: a training job reads what a build has computed, and
vice versa.

Examples
--------
>>> from dancedata.cache import FeatureCache
>>> rows = FeatureCache()("song.wav", "librosa35", fps=30, bpm=120)    # (T, 35), read-only
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.building.compute import Unit, cached_results, make, units_of
from dancedata.building.fields.music import MusicField
from dancedata.building.inputs import Music
from dancedata.building.signals import SignalId, identify_audio
from dancedata.building.song_fields import dataset_like, music_field, stated_tempo
from dancedata.core.clip import Reject
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import Number
from dancedata.execution.arithmetic import REFERENCE, expected, has_reference
from dancedata.execution.cache import Cache, CachedArray
from dancedata.execution.progress import Progress
from dancedata.execution.units import unit_runner
from dancedata.store import Store
from dancedata.store.normalize import TrainingData

__all__ = ["FeatureCache"]


class FeatureCache:
    """Features of audio files, computed at the first request and kept.

    Any number of processes, on machines that share the folder, may request the same feature at the same time: one
    computes it, the others wait. Objects are small and picklable, and safe to fork.

    Parameters
    ----------
    root
        Folder of the cache; default: $DANCEDATA_CACHE, else the user's cache folder.
    """

    def __init__(self, root: str | Path | None = None) -> None:
        self.root = Cache.at(root).root
        self._compared: set[Path] = set()
        self._jobs: dict[str, MusicField] = {}

    def __repr__(self) -> str:
        return f"FeatureCache({str(self.root)!r})"

    def __call__(
        self,
        song: str | Path,
        field: str = "librosa35",
        *,
        like: str | Path | Store | TrainingData | None = None,
        fps: Number = 30,
        bpm: float | None = None,
        windows: tuple[int, int] | None = None,
        **parameters: Any,
    ) -> npt.NDArray[Any]:
        """Return a feature of a song as `dancedata.features` does, of an audio file.

        Parameters
        ----------
        song
            An audio file. Only its signal counts, not its name; without `bpm`, `like` may state its tempo by it.
        field, like, fps, bpm, windows, parameters
            As in `dancedata.features`. Window k begins at frame ``k * windows[1]``.

        Returns
        -------
        (T, D) array, or (W, L, D) of W windows
            Of a whole song read-only and mapped: rows are read from the file at the first access, and processes of
            one machine share the memory. Copy the array to change it. W is 0 for a song shorter than a window.

        Raises
        ------
        DataError
            If the file cannot be decoded, or the feature cannot be computed of it.
        UsageError
            For an unknown feature, field or parameter, or a file that does not exist.
        """
        store = dataset_like(like)
        job = self._job(field, store, fps, windows, parameters)
        signal = self._identify(song)
        if bpm is None and store is not None:
            bpm, _ = stated_tempo(store, signal.sha256, Path(song))
        music = Music(signal, bpm=bpm)
        # A worker of a DataLoader may compute otherwise than builds: it takes what one has computed.
        accepted = dict.fromkeys((REFERENCE, expected()) if has_reference() else (expected(),))
        fields = [replace(job, arithmetic=instructions) for instructions in accepted]
        if windows is None:
            (rows,) = self._rows(fields, music, self._mapped)
            return rows
        of_windows = self._rows(fields, music, np.asarray)
        return np.stack(of_windows) if of_windows else np.empty((0, windows[0], job.columns.width), job.dtype)

    def _rows(
        self, fields: Sequence[MusicField], music: Music, read: Callable[[CachedArray], npt.NDArray[Any]]
    ) -> list[npt.NDArray[Any]]:
        """Return what is asked of a song, of the first field that has it; damaged entries are made again."""
        by_field = [list(units_of([field], [((field.id, ""), field.song_asks(music))])) for field in fields]
        rows: list[npt.NDArray[Any]] = []
        for units in zip(*by_field, strict=True):

            def read_all(cache: Cache, units: Sequence[Unit] = units) -> list[npt.NDArray[Any]]:
                return [read(_unwrapped(array)) for array in _made(cache, units).values()]

            rows += Cache(self.root).retry_lost(read_all, Progress(quiet=True))
        return rows

    def _identify(self, song: str | Path) -> SignalId:
        path = Path(song).expanduser().absolute()
        if not path.is_file():
            raise UsageError("the song does not exist", found=path)
        signal: SignalId = _unwrapped(identify_audio(Cache(self.root), path))
        return signal

    def _mapped(self, array: CachedArray) -> npt.NDArray[Any]:
        """Map an entry whose checksum was compared, once by each object."""
        if array.path not in self._compared:
            np.asarray(array)
            self._compared.add(array.path)
        return array.mapped()

    def _job(
        self, name: str, store: Store | None, fps: Number, windows: tuple[int, int] | None, parameters: dict[str, Any]
    ) -> MusicField:
        """Return a field with a resolved feature, as in a build; one object resolves it once."""
        request = repr((name, None if store is None else store.reference, fps, windows, sorted(parameters.items())))
        if request not in self._jobs:
            job = music_field(name, store, fps, windows, parameters)
            self._jobs[request] = replace(job, feature=job.feature.resolved(Cache(self.root).file_sha256))
        return self._jobs[request]


def _made(cache: Cache, units: Sequence[Unit]) -> dict[str, Any]:
    """Return the results of the first unit that is in the cache, or those of the last, run as a build does."""
    for unit in units:
        cached = cached_results(cache, unit)
        if cached is not None:
            return cached
    compute: Callable[..., dict[str, Any]] = unit_runner(not units[-1].wanted[0][0].lane)
    return compute(make, cache, units[-1])


def _unwrapped(result: Any) -> Any:
    if isinstance(result, Reject):
        raise DataError(result.detail, reason=result.reason)
    return result

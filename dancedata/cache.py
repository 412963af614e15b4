"""Features of songs for training jobs. Each is computed once for all processes.

`FeatureCache` is the cache that builds use, with the same keys: a training job reads what a build has computed, and
vice versa.

Examples
--------
>>> from dancedata.cache import FeatureCache
>>> rows = FeatureCache().get("librosa35", "song.wav", fps=30, start_bpm=120)    # (T, 35), read-only
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.building.compute import Unit, in_cache, make, units_of
from dancedata.building.fields.music import MusicField
from dancedata.building.inputs import Music
from dancedata.building.plugins import Ask
from dancedata.building.signals import SignalId, identify_audio
from dancedata.core.clip import Reject
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid, Number, WindowSpec
from dancedata.core.plugins import AudioFeature
from dancedata.core.registry import FEATURES
from dancedata.execution.arithmetic import REFERENCE, expected, has_reference
from dancedata.execution.cache import Cache, CachedArray, default_cache, with_lost_entries
from dancedata.execution.progress import Progress
from dancedata.execution.units import as_in_builds
from dancedata.recipes.plugins import make_named

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
        self.root = (Path(root).expanduser() if root is not None else default_cache()).absolute()
        self._compared: set[Path] = set()
        self._features: dict[str, AudioFeature] = {}

    def __repr__(self) -> str:
        return f"FeatureCache({str(self.root)!r})"

    def get(
        self,
        feature: str,
        song: str | Path,
        fps: Number = 30,
        start_bpm: float | None = None,
        **parameters: Any,
    ) -> npt.NDArray[Any]:
        """Return a feature of a whole song, as a build of whole clips has it.

        Parameters
        ----------
        feature
            Name of a registered audio feature, such as "librosa35".
        song
            An audio file. Only its signal counts, not its name.
        fps
            Rows per second.
        start_bpm
            Tempo to start from, where the feature tracks beats; None: it is estimated.
        parameters
            Parameters of the feature, as in a recipe.

        Returns
        -------
        (T, D) array
            Read-only and mapped: rows are read from the file at the first access, and processes of one machine
            share the memory. Copy the array to change it.

        Raises
        ------
        DataError
            If the file cannot be decoded, or the feature cannot be computed of it.
        UsageError
            For an unknown feature or parameter, or a file that does not exist.
        """
        field = MusicField(feature, FrameGrid.of(fps), self._feature(feature, parameters))
        music = Music(self._identify(song), bpm=start_bpm)
        fields = [replace(field, arithmetic=known) for known in _arithmetics()]
        (rows,) = self._rows(fields, lambda field: [field.ask(music)], self._mapped)
        return rows

    def get_windows(
        self,
        feature: str,
        song: str | Path,
        *,
        length_frames: int = 150,
        stride_frames: int = 15,
        fps: Number = 30,
        start_bpm: float | None = None,
        **parameters: Any,
    ) -> npt.NDArray[Any]:
        """Return a feature of all windows of a song, each by itself, as a build of slices has it.

        Parameters
        ----------
        length_frames, stride_frames
            Length and stride of the windows, in frames at `fps`. Window k begins at frame ``k * stride_frames``.
        feature, song, fps, start_bpm, parameters
            As in `get`.

        Returns
        -------
        (W, L, D) array
            W windows of L rows; W is 0 for a song shorter than a window.
        """
        if length_frames < 1 or stride_frames < 1:
            raise UsageError("windows have a length and a stride of at least 1", found=(length_frames, stride_frames))
        grid = FrameGrid.of(fps)
        windows = WindowSpec(length_frames, stride_frames, grid)
        field = MusicField(feature, grid, self._feature(feature, parameters), windows=windows)
        music = Music(self._identify(song), bpm=start_bpm)
        fields = [replace(field, arithmetic=known) for known in _arithmetics()]
        rows = self._rows(fields, lambda field: field.slice_asks(music), np.asarray)
        if not rows:
            return np.empty((0, length_frames, field.columns.width), field.dtype)
        return np.stack(rows)

    def _rows(
        self,
        fields: Sequence[MusicField],
        asks: Callable[[MusicField], Sequence[Ask]],
        read: Callable[[CachedArray], npt.NDArray[Any]],
    ) -> list[npt.NDArray[Any]]:
        """Return what is asked of a song, of the first field that has it; damaged entries are made again."""
        by_field = [list(units_of([field], [((field.id, ""), asks(field))])) for field in fields]
        rows: list[npt.NDArray[Any]] = []
        for units in zip(*by_field, strict=True):

            def read_all(cache: Cache, units: Sequence[Unit] = units) -> list[npt.NDArray[Any]]:
                return [read(_unwrapped(array)) for array in _made(cache, units).values()]

            rows += with_lost_entries(Cache(self.root), read_all, Progress(quiet=True))
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

    def _feature(self, name: str, parameters: dict[str, Any]) -> AudioFeature:
        """Return a resolved feature, as of a build; one object resolves it once."""
        request = repr((name, sorted(parameters.items())))
        if request not in self._features:
            plugin = make_named(FEATURES, "audio", name, parameters)
            self._features[request] = plugin.resolved(Cache(self.root).file_sha256)
        return self._features[request]


def _arithmetics() -> tuple[str, ...]:
    """Return the instructions whose results are taken, those that compute here last.

    A worker of a DataLoader may compute otherwise than builds; it takes what one has computed.
    """
    return tuple(dict.fromkeys((REFERENCE, expected()))) if has_reference() else (expected(),)


def _made(cache: Cache, units: Sequence[Unit]) -> dict[str, Any]:
    """Return the results of the first unit that is in the cache, or those of the last, run as a build does."""
    for unit in units:
        cached = in_cache(cache, unit)
        if cached is not None:
            return cached
    compute: Callable[..., dict[str, Any]] = as_in_builds(not units[-1].wanted[0][0].lane)
    return compute(make, cache, units[-1])


def _unwrapped(result: Any) -> Any:
    if isinstance(result, Reject):
        raise DataError(result.detail, reason=result.reason)
    return result

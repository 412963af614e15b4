"""AudioFeature: the base class of features of music."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.codebook import Codebook, DType
from dancedata.core.columns import Columns
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins.plugin import Plugin

#: Above it the squared spectrum might overflow float32; full scale is 1.
_MAX_SAMPLE = 1e12


class AudioFeature(Plugin):
    """Turns a signal into feature rows; `dancedata.audio.networks.feature.NetworkFeature` does it by a network.

    Attributes
    ----------
    packages
        Distributions whose version shapes the numbers; they are part of the cache key.
    exact
        Whether bits are the same on every machine. False for networks, whose bits differ within a tolerance; they are
        computed in the calling process.
    uses_tempo
        Whether `start_bpm` has an effect; if not, it is not part of the cache key.
    beat_rows_late
        Delay of the group "beat", rows: subtract it to get the instant of a beat.
    from_files
        Whether rows come from files: it is a `FileFeature`.
    """

    packages: ClassVar[tuple[str, ...]]
    exact: ClassVar[bool] = True
    uses_tempo: ClassVar[bool] = True
    beat_rows_late: ClassVar[int] = 0
    from_files: ClassVar[bool] = False

    @property
    def of_motion(self) -> bool:
        """Whether rows describe the dancer, not the music: every clip then has rows of its own."""
        return False

    @property
    def about(self) -> Mapping[str, Any]:
        """Metadata of its network for dataset.json: source, licence and the like; not part of any key."""
        return {}

    @property
    def windows_per_call(self) -> int | None:
        """Windows that `extract_windows` takes at once, and a killed build loses; None: all of a song."""
        return None

    def workers(self, jobs: int) -> int:
        """Return how many processes to run in, of `jobs`."""
        return jobs

    @property
    @abstractmethod
    def columns(self) -> Columns:
        """The D columns."""

    @property
    def dtype(self) -> DType:
        """Type on disk."""
        return "float32"

    @property
    def codebook(self) -> Codebook | None:
        """Codebook of the values; None for real values."""
        return None

    @abstractmethod
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Return the number of rows of `extract`, without computing them."""

    @abstractmethod
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> npt.NDArray[Any]:
        """Compute the rows of a whole signal.

        Parameters
        ----------
        signal
            Mono samples (n,) float32 at any rate.
        grid
            Rate of the rows.
        start_bpm
            Tempo at which a search for beats begins, beats per minute; None: estimated. Most features do not use it.

        Returns
        -------
        NDArray
            (T, D) in `dtype`, T = `n_rows(n, sample_rate, grid)`; row t is centred on t / rate seconds.

        Raises
        ------
        UsageError
            A rate or `start_bpm` out of range.
        DataError
            "empty_audio" (no sample), "nan" (samples that are not finite, or above 1e12), or "short_audio".
        """

    def extract_windows(
        self,
        signal: AudioSignal,
        starts: npt.NDArray[np.int64],
        n_samples: int,
        grid: FrameGrid,
        n_rows: int,
        *,
        start_bpm: float | None = None,
    ) -> npt.NDArray[Any]:
        """Compute windows (W, n_rows, D), each from its samples alone, as EDGE does with slices.

        The default calls `extract` for each `window`. Errors are those of `extract`; DataError "short_audio" if a
        window is not within the signal, or too short for `n_rows` rows.

        Parameters
        ----------
        signal, grid, start_bpm
            The whole song, and as in `extract`.
        starts, n_samples
            (W,) first sample of each window, and samples per window, at the signal's rate.
        n_rows
            Rows to keep of each window.
        """
        self.require_samples(signal)
        self.require_windows(signal, starts, n_samples)
        self.require_rows(self.n_rows(n_samples, signal.sample_rate, grid), n_rows, grid)
        windows = np.empty((len(starts), n_rows, self.columns.width), self.dtype)
        for rows, start in zip(windows, starts.tolist(), strict=True):
            rows[:] = self.extract(self.window(signal, start, n_samples), grid, start_bpm=start_bpm)[:n_rows]
        return windows

    def window(self, signal: AudioSignal, start: int, n_samples: int) -> AudioSignal:
        """Return the signal of a window."""
        return signal.part(start, start + n_samples)

    def with_weights(self, folder: Path) -> Self:
        """Return the feature with the weights of its network in a folder; itself if it has none."""
        return self

    def resolved(self, hash_file: Callable[[Path], str]) -> Self:
        """Return the feature with everything fixed that depends on this machine, such as a precision.

        `hash_file` gives the SHA-256 of a file. SourceError if a file with weights is missing, damaged, or of another
        network; UsageError if weights do not match the recipe's hash, or a package or the device is missing.
        """
        return self

    def estimated_bpm(self, signal: AudioSignal, grid: FrameGrid) -> float | None:
        """Return the tempo that `extract` estimates where `start_bpm` is None; None if it estimates none."""
        return None

    def estimated_window_bpms(
        self, signal: AudioSignal, starts: npt.NDArray[np.int64], n_samples: int, grid: FrameGrid
    ) -> list[float] | None:
        """Return the tempos that `extract_windows` estimates, one per window; None if it estimates none."""
        return None

    @classmethod
    def make_example(cls, folder: Path) -> Self:
        """Return the feature with its defaults, for tests; one that needs files writes small ones into the folder."""
        return cls()

    def require_samples(self, signal: AudioSignal) -> None:
        """Raise DataError for a signal without samples, or with samples whose spectrum would overflow."""
        if len(signal.samples) == 0:
            raise DataError(f"{self.name}: the signal has no samples", reason="empty_audio", found="0 samples")
        # Not "any > maximum": NaN fails every comparison.
        bad = np.flatnonzero(~(np.abs(signal.samples) <= _MAX_SAMPLE))
        if bad.size:
            raise DataError(f"{self.name}: the signal has samples that are NaN, infinite or too large", reason="nan",
                            found=f"{bad.size} samples, the first is {signal.samples[bad[0]]} at sample {bad[0]}",
                            allowed=f"finite samples up to {_MAX_SAMPLE:g} (full scale is 1)",
                            fix="export the file again, for example as 16-bit wav")  # fmt: skip

    def require_windows(self, signal: AudioSignal, starts: npt.NDArray[np.int64], n_samples: int) -> None:
        """Raise DataError if a window of `n_samples` samples is not within the signal."""
        if len(starts) == 0:
            return
        first, last = int(np.min(starts)), int(np.max(starts)) + n_samples
        if first < 0 or last > len(signal.samples):
            raise DataError(f"{self.name}: a window reaches beyond the audio", reason="short_audio",
                            found=f"windows from sample {first} to {last}",
                            allowed=f"0 to {len(signal.samples)} (at {signal.sample_rate} Hz)")  # fmt: skip

    def require_rows(self, available: int, n_rows: int, grid: FrameGrid) -> None:
        """Raise DataError if windows have fewer rows than requested."""
        if n_rows > available:
            raise DataError(f"{self.name}: the windows are too short", reason="short_audio",
                            found=f"windows of {available} rows",
                            allowed=f"audio for {n_rows} rows at {grid.rate} frames per second")  # fmt: skip

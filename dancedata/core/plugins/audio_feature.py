"""AudioFeature: the base class of features of music."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins.plugin import Plugin


class AudioFeature(Plugin):
    """Turns a signal into feature rows.

    Attributes
    ----------
    packages
        Distributions whose version shapes the numbers; they are part of the cache key.
    exact
        Whether bits are the same on every machine. False for networks, whose bits differ within a tolerance; they are
        computed in the calling process.
    uses_tempo
        Whether `start_bpm` has an effect; if not, it is not part of the cache key.
    reads_ahead
        Whether it computes on a device, so that the next song may be decoded meanwhile.
    beat_rows_late
        How many rows after its instant a beat stands in the group "beat": whoever wants the instant subtracts them.
    """

    packages: ClassVar[tuple[str, ...]]
    exact: ClassVar[bool] = True
    uses_tempo: ClassVar[bool] = True
    reads_ahead: ClassVar[bool] = False
    beat_rows_late: ClassVar[int] = 0

    @property
    @abstractmethod
    def columns(self) -> Columns:
        """The D columns."""

    @property
    def dtype(self) -> Literal["float32", "float16"]:
        """Type on disk."""
        return "float32"

    @property
    def windows_a_call(self) -> int | None:
        """Windows that `extract_windows` takes at once, after which they are published; None: all of a song."""
        return None

    @property
    def about(self) -> Mapping[str, Any]:
        """What dataset.json says of a network: its source, licence and the like, as JSON; not part of any key."""
        return {}

    @abstractmethod
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Return how many rows `extract` gives, without computing them."""

    @abstractmethod
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> npt.NDArray[Any]:
        """Return (T, D) rows of a whole signal at the rate of `grid` (scope: track)."""

    @abstractmethod
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
        """Return (W, n_rows, D): windows of `n_samples` samples, each by itself, as EDGE does (scope: window)."""

    def resolved(self, hash_file: Callable[[Path], str]) -> Self:
        """Return the feature with everything fixed that depends on this machine, such as a precision.

        Parameters
        ----------
        hash_file
            Gives the SHA-256 of a file, such as one with weights.
        """
        return self

    def with_weights(self, folder: Path) -> Self:
        """Return the feature with the weights in a folder; one that has no weights stays as it is."""
        return self

    def workers(self, jobs: int) -> int:
        """Return how many processes to run in, of `jobs`: one for each card, for example."""
        return jobs

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

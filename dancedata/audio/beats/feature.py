"""Beats, downbeats, phase in the bar and tempo of music as an audio feature of recipes."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.beats.track import BeatTrack
from dancedata.audio.networks.feature import NetworkFeature
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.packages import require
from dancedata.core.registry import FEATURES
from dancedata.core.text import shown
from dancedata.core.typing import override
from dancedata.kernel import resample

#: Names the file of the network's weights unless a recipe does.
ENVIRONMENT = "DANCEDATA_BEAT_THIS"

Source = Literal["librosa", "beat_this"]
_SOURCES = ("librosa", "beat_this")
_UNITS = {"beat": "0/1", "downbeat": "0/1", "phase": "bars", "tempo": "1/min"}
#: Of the onset envelope that librosa finds beats in: 50 frames per second.
SAMPLE_RATE, HOP, N_FFT = 22050, 441, 1024


@FEATURES.register("beats")
@dataclass(frozen=True)
class Beats(NetworkFeature):
    """Beat 0/1, downbeat 0/1, phase in the bar [0, 1), tempo in beats per minute.

    A beat is in the row nearest to it. Phase is -1 where no downbeat was found, tempo is 0 where fewer than two beats
    were. Scope window restarts the count of bars in every window, so track is better for phases. No metric takes its
    beats from here: published scores are comparable with librosa's of `librosa35`.

    Attributes
    ----------
    source
        "librosa": its beat tracker; no weights, no downbeats. "beat_this": the network of Beat This! (Foscarin,
        Schlueter, Widmer, ISMIR 2024), beats and downbeats.
    weights
        File with the network's weights, final0.ckpt or small0.ckpt of Beat This!, or a safetensors file. Default:
        $DANCEDATA_BEAT_THIS.
    weights_sha256
        SHA-256 of that file. A build fills it in; if it is given, the file must match.
    device
        Such as "cuda:1" or "cpu"; "auto": every card, one process each, else the CPU.
    """

    columns: ClassVar[Columns] = Columns(tuple(Group(name, 1, unit) for name, unit in _UNITS.items()))
    #: Not torch: another version of it moves logits by about 1e-6, and beats are whole frames of 20 ms.
    packages: ClassVar[tuple[str, ...]] = ("librosa", "numpy", "scipy", "soxr")
    uses_tempo: ClassVar[bool] = True

    source: Source = "librosa"
    weights: Path | None = field(default=None, metadata={"path": True})
    weights_sha256: str = ""
    device: str = field(default="auto", metadata={"path": True})

    def __post_init__(self) -> None:
        if self.source not in _SOURCES:
            raise UsageError("beats: unknown source", found=self.source, allowed=", ".join(_SOURCES))
        if self.source == "librosa" and (self.weights is not None or self.weights_sha256):
            raise UsageError("beats: the source librosa has no weights", found=self.weights or self.weights_sha256,
                             fix="set source: beat_this, or leave weights out")  # fmt: skip

    @override
    def with_weights(self, folder: Path) -> Beats:
        return replace(self, weights=folder) if self.source == "beat_this" else self

    @override
    def resolved(self, hash_file: Callable[[Path], str]) -> Beats:
        """Return the feature with the hash of the weights resolved."""
        if self.source == "librosa":
            return self
        path = self.weights_path()
        require("beats", what="beats: the source beat_this")
        self.checked_device()
        sha256 = self.checked_hash(hash_file)
        return replace(self, weights=path, weights_sha256=sha256)

    @property
    @override
    def windows_per_call(self) -> None: ...

    @override
    def workers(self, jobs: int) -> int:
        return (len(self.cards()) if self.source == "beat_this" else 0) or jobs

    @override
    def weights_path(self) -> Path:
        named = os.environ.get(ENVIRONMENT)
        path = self.weights or (Path(named) if named else None)
        if path is None:
            raise UsageError(
                "beats: the file of the weights is unknown (they are not part of this package)",
                fix=f"set {ENVIRONMENT}, or audio.beats.weights in the recipe, to final0.ckpt or small0.ckpt of "
                "Beat This!, or take source: librosa",
            )
        return path.absolute()

    @override
    def weights_hash(self, hash_file: Callable[[Path], str]) -> str:
        path = self.weights_path()
        try:
            return hash_file(path)
        except OSError as error:
            missing = isinstance(error, FileNotFoundError)
            raise SourceError(
                f"beats: the file of the weights {'does not exist' if missing else 'cannot be read'}",
                where=path,
                found=None if missing else shown(error),
                fix="set weights to final0.ckpt or small0.ckpt of Beat This!, or take source: librosa",
            ) from error

    @override
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        return FrameGrid.of(sample_rate).resampled_length(n_samples, grid)

    @override
    def estimated_bpm(self, signal: AudioSignal, grid: FrameGrid) -> float | None:
        if self.source != "librosa":
            return None
        self.require_samples(signal)
        from dancedata.audio._librosa import estimated_bpm

        return estimated_bpm(signal.samples, signal.sample_rate)

    @override
    def estimated_window_bpms(
        self, signal: AudioSignal, starts: NDArray[np.int64], n_samples: int, grid: FrameGrid
    ) -> list[float] | None:
        if self.source != "librosa":
            return None
        self.require_windows(signal, starts, n_samples)
        from dancedata.audio._librosa import estimated_bpm

        windows = (signal.samples[start : start + n_samples] for start in starts.tolist())
        return [estimated_bpm(window, signal.sample_rate) for window in windows]

    @override
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> NDArray[np.float32]:
        """Beats of a whole song, (T, 4); see `AudioFeature.extract`.

        `start_bpm` is where librosa's search for the tempo starts; the network does not use it. "short_audio": less
        than 24 ms with the network. SourceError if its weights are missing, damaged, or of another network.
        """
        if start_bpm is not None and not (math.isfinite(start_bpm) and start_bpm > 0):
            raise UsageError("beats: invalid value for start_bpm", found=start_bpm, allowed="above 0, or None")
        self.require_samples(signal)
        n_rows = self.n_rows(signal.n_samples, signal.sample_rate, grid)
        return self.track(signal, start_bpm=start_bpm).rows(n_rows, grid)

    def track(self, signal: AudioSignal, *, start_bpm: float | None = None) -> BeatTrack:
        """Return the beats themselves, which have no rate of rows; parameters and errors as for `extract`."""
        if self.source == "librosa":
            return _librosa_beats(signal, start_bpm)
        require("beats", what="beats: the source beat_this")
        from dancedata.audio.beats.by_network import network_beats
        from dancedata.audio.beats.weights import load_network
        from dancedata.audio.networks.devices import require_device

        device, path = require_device(self.device_of_process()), self.weights_path()
        return network_beats(signal, self.network((path, str(device)), lambda: load_network(path).to(device)), device)


def _librosa_beats(signal: AudioSignal, start_bpm: float | None) -> BeatTrack:
    """Return the beats of a signal by librosa, without downbeats; none for silence.

    An onset envelope, one tempo for the signal, dynamic programming (Ellis 2007). Frames of the envelope begin at
    their instant, and are half as long as librosa's default. With the default, beats come a row late
    (docs/reference/columns.md); so, on nine songs with known beats, they are within 15 ms on both sides.

    `start_bpm`: Where the search for the tempo starts, in beats per minute; None: at librosa's estimate.
    """
    from dancedata.audio._librosa import compile_kernels, estimated_bpm, known_warnings

    compile_kernels()
    import librosa

    if start_bpm is None:
        start_bpm = estimated_bpm(signal.samples, signal.sample_rate)
    samples = resample(signal.samples, signal.sample_rate, SAMPLE_RATE)
    padded = np.pad(samples, (0, N_FFT))
    with known_warnings():
        envelope = librosa.onset.onset_strength(y=padded, sr=SAMPLE_RATE, hop_length=HOP, n_fft=N_FFT, center=False)
        _, beat_frames = librosa.beat.beat_track(
            onset_envelope=envelope, sr=SAMPLE_RATE, hop_length=HOP, start_bpm=start_bpm
        )
    frames: NDArray[np.int64] = np.asarray(beat_frames, dtype=np.int64)
    return BeatTrack(frames, np.zeros(len(frames), dtype=np.bool_), FrameGrid.of(SAMPLE_RATE // HOP))

"""Learned music features of any encoder in the Hugging Face layout, as an audio feature of recipes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.audio.hf.model_folder import ENVIRONMENT, ModelFolder, licence_of, open_model
from dancedata.audio.hf.settings import Settings, settings_of
from dancedata.audio.networks.feature import NetworkFeature, Precision
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.packages import require
from dancedata.core.registry import FEATURES
from dancedata.core.typing import override

if TYPE_CHECKING:
    from dancedata.audio.hf.encoder import HuggingFaceEncoder

__all__ = ["ENVIRONMENT", "HuggingFace"]


@FEATURES.register("hf")
@dataclass(frozen=True)
class HuggingFace(NetworkFeature):
    """Learned features of an encoder in the Hugging Face layout: MERT, MuQ, HuBERT, EnCodec, Whisper and others.

    A recipe may have several: `hf.mert`, `hf.encodec`. Networks are classes of transformers, and for MuQ one of this
    package; code in a model's folder is never run. Each frame has an exact time stamp; row j is at j / fps. A
    song is computed in overlapping chunks, the middle of each is kept, and the song normalised as a whole; slices are
    computed alone.

    Attributes
    ----------
    model
        Folder with config.json and weights, or an id on the Hugging Face hub that is in this machine's cache. Nothing
        is downloaded. Default: $DANCEDATA_HF_MODEL.
    revision
        Commit of a hub id, 40 hex digits. Default: the one that the cache has.
    model_sha256
        Hash that identifies weights and config. A build fills it in; if it is given, the model must match.
    output
        "hidden": activations of `layers`; "embedding": what enters a codec's quantiser; "codes": a codec's codes.
        "auto": hidden, or embedding of a codec; a build records which.
    layers
        A number, a list of numbers, a range such as "4..8", "last", "all", or "mean" of all. Layer 0 is what enters
        the first block, the last layer is the output of the network.
    reduce
        "concat": several layers are concatenated; "mean": they are averaged.
    chunk_s
        Scope track: length of chunks in seconds. Default: 30; 1 of EnCodec at 48 kHz; of encoders of spectrograms the
        length of their windows.
    overlap_s
        Scope track: least overlap of adjacent chunks in seconds. Default: 4, or 2 of codecs and of encoders of
        spectrograms, and a fifth of shorter chunks.
    resample
        How frames become rows. "area": each frame counts for as long as its hop overlaps with the row's; "linear"
        between the two frames around a row; "nearest". "auto": area if the encoder is faster than the recipe, else
        linear; nearest for codes.
    normalize
        "extractor": as preprocessor_config.json says, over the song or window; "none": not at all.
    precision
        Type of weights and products. "auto": fp16 on CUDA, fp32 on a CPU; a build records the resolved value.
    store
        Type of the rows. What exceeds the range of float16 is an error.
    device
        Such as "cuda:1" or "cpu"; "auto": every card, one process each, else the CPU. It affects the numbers only
        through the precision.
    batch_size
        Chunks or windows at once, all of equal length; 0: 16 on a card, halved where memory runs out, 1 on a CPU.
    """

    #: Not transformers: its releases do not change these numbers, as the golden test checks.
    packages: ClassVar[tuple[str, ...]] = ("torch", "soxr")
    weights_key: ClassVar[str] = "model"

    model: str = field(default="", metadata={"path": True})
    revision: str | None = field(default=None, metadata={"path": True})
    model_sha256: str = ""
    output: Literal["auto", "hidden", "embedding", "codes"] = "auto"
    layers: int | tuple[int, ...] | str = "last"
    reduce: Literal["concat", "mean"] = "concat"
    chunk_s: float | None = None
    overlap_s: float | None = None
    resample: Literal["auto", "area", "linear", "nearest"] = "auto"
    normalize: Literal["extractor", "none"] = "extractor"
    precision: Precision = "auto"
    store: Literal["float16", "float32"] = "float16"
    device: str = field(default="auto", metadata={"path": True})
    batch_size: int = field(default=0, metadata={"path": True})

    def __post_init__(self) -> None:
        if isinstance(self.layers, list):
            object.__setattr__(self, "layers", tuple(self.layers))
        if self.batch_size < 0:
            raise UsageError("hf: invalid value for batch_size", found=self.batch_size, allowed="0 or more")
        seconds = {"chunk_s": self.chunk_s, "overlap_s": self.overlap_s}
        wrong = [f"{key} {value:g}" for key, value in seconds.items() if value is not None and not 0 <= value < 1e6]
        if wrong:
            raise UsageError("hf: invalid value", found=", ".join(wrong), allowed="seconds, 0 or more")

    @override
    def with_weights(self, folder: Path) -> HuggingFace:
        return replace(self, model=str(folder), revision=None)

    @property
    @override
    def columns(self) -> Columns:
        return self._settings().columns

    @property
    @override
    def dtype(self) -> Literal["float32", "float16"]:
        return self.store

    @property
    @override
    def about(self) -> Mapping[str, Any]:
        settings = self._settings()
        folder, timing = settings.folder, settings.family.timing
        return {
            "model": folder.source,
            "revision": folder.revision,
            "sha256": self.model_sha256,
            "family": f"{settings.family.name} {settings.family.version}",
            "frames_per_s": str(timing.rate),
            "first_frame_s": str(timing.first_centre / timing.sample_rate),
            "licence": licence_of(folder.path),
        }

    @override
    def resolved(self, hash_file: Callable[[Path], str]) -> HuggingFace:
        """Return the feature with output, chunks, precision and the hash of the model resolved."""
        require("hf", what="the audio feature hf")
        device = str(self.checked_device())
        folder = self._folder()
        settings = self._settings(folder)
        sha256 = self.checked_hash(hash_file)
        return replace(
            self,
            model=self.model if folder.from_hub else str(folder.path),
            revision=folder.revision if folder.from_hub else None,
            model_sha256=sha256,
            output=settings.output,
            chunk_s=settings.chunk_s,
            overlap_s=settings.overlap_s,
            precision=self._precision(device),
        )

    @override
    def weights_path(self) -> Path:
        return self._folder().path

    @override
    def weights_hash(self, hash_file: Callable[[Path], str]) -> str:
        return self._folder().sha256(hash_file)

    @override
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        return FrameGrid.of(sample_rate).resampled_length(n_samples, grid)

    @override
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> npt.NDArray[Any]:
        """Embed a whole song, (T, D) in the type of `store`.

        "short_audio": less than a frame of the encoder; "overflow": numbers that are not finite or exceed the type.
        """
        self.require_samples(signal)
        n_rows = self.n_rows(signal.n_samples, signal.sample_rate, grid)
        return self._rows([signal.samples], signal.sample_rate, grid, n_rows)[0]

    @override
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
        self.require_samples(signal)
        self.require_windows(signal, starts, n_samples)
        self.require_rows(self.n_rows(n_samples, signal.sample_rate, grid), n_rows, grid)
        if not len(starts):
            return np.empty((0, n_rows, self.columns.width), self.store)
        windows = [signal.samples[int(start) : int(start) + n_samples] for start in starts]
        return np.stack(self._rows(windows, signal.sample_rate, grid, n_rows))

    def _rows(
        self, signals: Sequence[npt.NDArray[np.float32]], sample_rate: int, grid: FrameGrid, n_rows: int
    ) -> list[npt.NDArray[Any]]:
        finish = partial(self.in_dtype, fix="set store: float32, or choose another layer")
        with self.all_cores():
            return self._encoder().rows(
                signals, sample_rate, grid, n_rows, finish=finish, batch_size=self.batch_size or None
            )

    def _precision(self, device: str) -> Precision:
        if self.precision == "auto":
            return "fp16" if device.startswith("cuda") else "fp32"
        if self.precision == "fp16" and not device.startswith("cuda"):
            slow = "hf: fp16 on a CPU takes many times as long as fp32"
            raise UsageError(slow, found="precision fp16", allowed="auto, fp32, bf16")
        return self.precision

    def _folder(self) -> ModelFolder:
        return open_model(self.model, self.revision)

    def _settings(self, folder: ModelFolder | None = None) -> Settings:
        return settings_of(folder or self._folder(), **self._keys())

    def _keys(self) -> dict[str, Any]:
        """Return what is taken of the model, and how."""
        keys = ("output", "layers", "reduce", "chunk_s", "overlap_s", "resample", "normalize")
        return {key: getattr(self, key) for key in keys}

    def _encoder(self) -> HuggingFaceEncoder:
        """Return the network of this process."""
        require("hf", what="the audio feature hf")
        from dancedata.audio.hf.encoder import HuggingFaceEncoder

        device = self.device_of_process()
        precision = self._precision(device)
        return self.network(
            (self.model, self.revision, *self._keys().values(), precision, device),
            lambda: HuggingFaceEncoder(self._settings(), device=device, precision=precision),
        )

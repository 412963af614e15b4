"""Jukebox embeddings as an audio feature of recipes."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.contexts import contexts_of
from dancedata.audio.signal import pcm16, resampled_length
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import json_sha256
from dancedata.core.plugins import AudioFeature
from dancedata.core.registry import FEATURES
from dancedata.core.strict_json import read_json
from dancedata.core.text import shown

if TYPE_CHECKING:
    from dancedata.audio.jukebox import JukeboxEncoder

#: Names the folder of the weights where a recipe does not.
ENVIRONMENT = "DANCEDATA_JUKEBOX"
#: Sizes of another network than the real one, beside OpenAI's files.
HPARAMS_FILE = "hparams.json"

Precision = Literal["auto", "fp32", "fp16", "bf16"]


@FEATURES.register("jukebox")
@dataclass(frozen=True)
class Jukebox(AudioFeature):
    """Activations of OpenAI's Jukebox 5b prior (Dhariwal et al. 2020), EDGE's music features.

    Scope window is EDGE's: each window, quantised to 16 bit, by itself, with its own gain and its own start. Scope
    track runs over a song in overlapping contexts of 23.5 s with one gain for the song, which costs about a
    tenth; docs/decisions/0024 says what differs. The weights are OpenAI's, under a Noncommercial Use License.

    Attributes
    ----------
    weights
        Folder with OpenAI's two files, or a converted one. Default: $DANCEDATA_JUKEBOX.
    weights_sha256
        What identifies the weights. Filled in by a build; if it is given, the weights must have it.
    layer
        1 to 72; EDGE takes 66.
    precision
        Type of weights and products; the residual stream is float32 in all. "auto": fp16 on CUDA, fp32 on a CPU;
        a build fixes it and records what it became.
    overlap_s
        Scope track: seconds that neighbouring contexts share at least.
    device
        Such as "cuda:1" or "cpu"; "auto": every card, one process each, else the CPU. Shapes no number beyond the
        precision.
    batch_size
        Windows at once; 0: as many as the device's free memory takes.
    """

    version: ClassVar[int] = 1
    packages: ClassVar[tuple[str, ...]] = ("torch", "soxr")
    #: The next song is decoded while the device computes.
    reads_ahead: ClassVar[bool] = True
    exact: ClassVar[bool] = False
    uses_tempo: ClassVar[bool] = False

    weights: Path | None = field(default=None, metadata={"path": True})
    weights_sha256: str = ""
    layer: int = 66
    precision: Precision = "auto"
    overlap_s: float = 4.0
    device: str = field(default="auto", metadata={"path": True})
    batch_size: int = field(default=0, metadata={"path": True})

    def __post_init__(self) -> None:
        """Check what can be checked without the weights."""
        if self.layer < 1 or self.batch_size < 0:
            raise UsageError("jukebox: layer begins at 1 and batch_size at 0", found=(self.layer, self.batch_size))

    @classmethod
    def make_example(cls, folder: Path) -> Jukebox:
        """Write a tiny random checkpoint in the real layout; returns the feature on it. For tests."""
        from dancedata.audio.jukebox.weights.random_weights import random_checkpoint
        from dancedata.core.hashing import sha256_file

        random_checkpoint(folder)
        return cls(weights=folder, layer=6, device="cpu").resolved(sha256_file)

    def with_weights(self, folder: Path) -> Jukebox:
        """Return the feature with the weights in a folder."""
        return replace(self, weights=folder)

    @property
    def columns(self) -> Columns:
        """As many columns as the network is wide: 4800."""
        return Columns((Group(f"layer{self.layer}", self._config.width, "1"),))

    @property
    def dtype(self) -> Literal["float32", "float16"]:
        """Half precision: as exact as the network in fp16, and half the space."""
        return "float16"

    @property
    def windows_a_call(self) -> int:
        """Windows between two that are published: a build that is killed loses so many at most."""
        return self.batch_size or (32 if self._devices() else 1)

    def resolved(self, hash_file: Callable[[Path], str]) -> Jukebox:
        """Return the feature with precision and weights' hash fixed.

        Raises
        ------
        SourceError
            If there is no folder of weights, or they are of another network.
        UsageError
            If the weights are others than `weights_sha256` says or lack the layer, or there is no such device.
        """
        from dancedata.audio.jukebox.arguments import require_device, require_layers
        from dancedata.audio.jukebox.network.precision import resolve_precision

        folder = self._folder()
        cards = self._devices() or ["cpu" if self.device == "auto" else self.device]
        device = require_device(cards[0])
        sha256 = json_sha256({"files": _file_hashes(folder, hash_file), "config": self._config.to_json()})
        if self.weights_sha256 not in ("", sha256):
            raise UsageError(
                "jukebox: these are other weights than the recipe's",
                where=folder,
                found=sha256,
                allowed=self.weights_sha256,
                fix="name the folder that has them, or leave weights_sha256 out",
            )
        require_layers((self.layer,), _highest_layer(folder))
        precision: Any = resolve_precision(self.precision, device)
        return replace(self, weights=folder, weights_sha256=sha256, precision=precision)

    def workers(self, jobs: int) -> int:
        """Return how many processes it is worth running in: one a card, one on a CPU."""
        return max(1, len(self._devices()))

    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Return the rows of a whole song: one for every frame that begins before its last code ends."""
        from dancedata.audio.jukebox.network.resampling import n_frames

        config = self._config
        contexts_of(1, n_ctx=config.n_ctx, code_rate=config.code_rate, fps=grid.rate, overlap_s=self._overlap)
        codes = resampled_length(n_samples, sample_rate, config.sample_rate) // config.hop
        return n_frames(codes, grid.rate, config.code_rate)

    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> npt.NDArray[Any]:
        """Embed a whole song (scope: track).

        Parameters
        ----------
        start_bpm
            Not used.

        Returns
        -------
        (T, D) float16

        Raises
        ------
        DataError
            "short_audio" for a song of less than one code, 128 samples at 44.1 kHz.
        """
        from dancedata.audio.jukebox.clips import prepare

        encoder, config = self._encoder(self._config.n_ctx), self._config
        audio = prepare(signal.samples, signal.sample_rate, config)
        n_codes = len(audio) // config.hop
        parts = contexts_of(
            n_codes, n_ctx=config.n_ctx, code_rate=config.code_rate, fps=grid.rate, overlap_s=self._overlap
        )
        clips = [audio[p.first_code * config.hop : (p.first_code + p.n_codes) * config.hop] for p in parts[:-1]]
        # The last one hears the samples that make no whole code, as a clip does.
        clips.append(audio[parts[-1].first_code * config.hop :])
        with self._threads():
            found = encoder.embed_prepared(clips, float(grid.rate), batch_size=self.batch_size or None)
        rows = [one[self.layer][p.keep_from : p.keep_to] for p, one in zip(parts, found, strict=True)]
        return self._stored(np.concatenate(rows))

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
        """Embed windows, each by itself, as EDGE does (scope: window).

        Returns
        -------
        (W, n_rows, D) float16

        Raises
        ------
        DataError
            "short_audio" for a window beyond the signal's end; "long_audio" for windows of more than 23.78 s.
        """
        if len(starts) and int(np.max(starts)) + n_samples > signal.n_samples:
            raise DataError(
                "jukebox: a window reaches beyond the signal",
                reason="short_audio",
                found=f"samples {int(np.max(starts))} to {int(np.max(starts)) + n_samples}",
                allowed=f"up to {signal.n_samples}",
            )
        clips = [pcm16(signal.samples[start : start + n_samples]) for start in starts]
        codes = resampled_length(n_samples, signal.sample_rate, self._config.sample_rate) // self._config.hop
        with self._threads():
            found = self._encoder(codes).embed_batch(
                clips, signal.sample_rate, float(grid.rate), batch_size=self.batch_size or None
            )
        rows = [one[self.layer][:n_rows] for one in found]
        if any(len(one) < n_rows for one in rows):
            raise DataError(
                "jukebox: a window has too few codes for its rows",
                reason="short_audio",
                found=f"{min(map(len, rows))} rows",
                allowed=f"{n_rows}",
            )
        width = self._config.width
        return self._stored(np.stack(rows) if rows else np.empty((0, n_rows, width), np.float32))

    @property
    def _overlap(self) -> Fraction:
        return Fraction(str(self.overlap_s))

    @property
    def _config(self) -> JukeboxConfig:
        folder = self.weights or _named_folder()
        return config_of(folder) if folder is not None else JukeboxConfig()

    def _folder(self) -> Path:
        folder = self.weights or _named_folder()
        if folder is None:
            raise UsageError(
                "jukebox needs its weights, which are no part of this package",
                fix=f"set {ENVIRONMENT} to the folder that `dancedata jukebox fetch` or `convert` wrote, or "
                "audio.jukebox.weights in the recipe",
            )
        if not folder.is_dir():
            raise SourceError("there is no folder of Jukebox's weights", where=folder)
        return folder.absolute()

    def _devices(self) -> list[str]:
        """Return the cards to compute on; none on a CPU."""
        if self.device != "auto":
            return [self.device] if self.device.startswith("cuda") else []
        import torch

        return [f"cuda:{k}" for k in range(torch.cuda.device_count())]

    def _encoder(self, n_codes: int) -> JukeboxEncoder:
        """Return the network, with tables for clips of up to so many codes."""
        from dancedata.audio.jukebox.memory import padded_length

        device = self.device
        if device == "auto":
            from dancedata.audio.jukebox.devices import claimed

            device = claimed(tuple(self._devices())) or "cpu"
        # Whole rows, as it computes: one length for songs of all sample rates.
        longest = min(padded_length(self._config, max(n_codes, 1)), self._config.n_ctx)
        return _loaded(self._folder(), self.weights_sha256, self.layer, self.precision, device, longest)

    def _threads(self) -> Any:
        """All cores on a CPU: a build runs one process of this feature there."""
        if self._devices():
            return nullcontext()
        from loky import cpu_count
        from threadpoolctl import threadpool_limits

        # What this process may use: a batch system gives it a part of the machine.
        return threadpool_limits(limits=cpu_count())

    def _stored(self, rows: npt.NDArray[np.float32]) -> npt.NDArray[np.float16]:
        largest = float(np.abs(rows).max(initial=0))
        if not largest <= float(np.finfo(np.float16).max):
            raise DataError(
                "jukebox: an activation does not fit float16",
                reason="overflow",
                found=largest,
                fix="choose another layer",
            )
        return rows.astype(np.float16)


def _named_folder() -> Path | None:
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else None


@lru_cache(maxsize=8)
def config_of(folder: Path) -> JukeboxConfig:
    """Return the sizes of a folder's network: the real ones, unless hparams.json or a conversion says otherwise."""
    from dancedata.audio.jukebox.conversion import DESCRIPTION_FILE, read_description
    from dancedata.audio.jukebox.weights.names import MAX_JSON_BYTES

    if (folder / DESCRIPTION_FILE).exists():
        return read_description(folder).config
    path = folder / HPARAMS_FILE
    if not path.exists():
        return JukeboxConfig()
    try:
        return JukeboxConfig.from_hparams(read_json(path, MAX_JSON_BYTES))
    except (OSError, ValueError, TypeError, AttributeError, KeyError, IndexError) as error:
        raise SourceError("the sizes of the network cannot be read", where=path, found=shown(error)) from error


def _file_hashes(folder: Path, hash_file: Callable[[Path], str]) -> dict[str, str]:
    """Return the hashes of OpenAI's files, also for a folder converted from them."""
    from dancedata.audio.jukebox.conversion import DESCRIPTION_FILE, read_description
    from dancedata.audio.jukebox.weights.loading import refuse_hugging_face
    from dancedata.audio.jukebox.weights.names import PRIOR_FILE, VQVAE_FILE

    if (folder / DESCRIPTION_FILE).exists():
        return dict(read_description(folder).source)
    refuse_hugging_face(folder)
    missing = [name for name in (VQVAE_FILE, PRIOR_FILE) if not (folder / name).is_file()]
    if missing:
        raise SourceError(
            "a file of Jukebox's weights is missing",
            where=folder,
            found=", ".join(missing) + " not there",
            fix="get both with `dancedata jukebox fetch`",
        )
    return {name: hash_file(folder / name) for name in (VQVAE_FILE, PRIOR_FILE)}


def _highest_layer(folder: Path) -> int:
    """Return the last layer that the folder has the weights of."""
    from dancedata.audio.jukebox.conversion import DESCRIPTION_FILE, read_description

    return read_description(folder).layer if (folder / DESCRIPTION_FILE).exists() else config_of(folder).depth


#: The network of this process, by what it was loaded from and for.
_network: dict[tuple[Any, ...], JukeboxEncoder] = {}


def _loaded(
    folder: Path, weights_sha256: str, layer: int, precision: str, device: str, max_codes: int
) -> JukeboxEncoder:
    """Load the weights once a process.

    Their hash is part of what they are known by: other files may have come into the folder since.
    """
    from dancedata.audio.jukebox import JukeboxEncoder
    from dancedata.audio.jukebox.conversion import DESCRIPTION_FILE

    key = (folder, weights_sha256, layer, precision, device, max_codes)
    if key not in _network:
        # The one before goes first: few devices have room for two.
        _network.clear()
        how: Any = {"layers": (layer,), "device": device, "precision": precision, "max_codes": max_codes}
        if (folder / DESCRIPTION_FILE).exists():
            _network[key] = JukeboxEncoder.from_converted(folder, **how)
        else:
            _network[key] = JukeboxEncoder.from_openai(folder, config=config_of(folder), **how)
    return _network[key]

"""Jukebox embeddings as an audio feature of recipes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.audio.jukebox.clips import n_frames, prepare
from dancedata.audio.jukebox.config import JukeboxConfig, require_layers
from dancedata.audio.jukebox.weights.folder import checkpoint_sha256, config_of
from dancedata.audio.networks.feature import NetworkFeature, Precision
from dancedata.core.audio_signal import AudioSignal, pcm16, resampled_length
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import json_sha256
from dancedata.core.packages import require
from dancedata.core.registry import FEATURES
from dancedata.core.typing import override

if TYPE_CHECKING:
    from dancedata.audio.jukebox.encoder import JukeboxEncoder

#: Names the folder of the weights unless a recipe does.
ENVIRONMENT = "DANCEDATA_JUKEBOX"
#: Seconds at the end of a context whose rows come from the next one: Fourier resampling treats a context as periodic,
#: so its ends ring into each other, and the last codes lack the samples that follow.
TAIL_S = Fraction(16, 30)


@FEATURES.register("jukebox")
@dataclass(frozen=True)
class Jukebox(NetworkFeature):
    """Activations of OpenAI's Jukebox 5b prior (Dhariwal et al. 2020), EDGE's music features.

    Scope window is EDGE's: each window, quantised to 16 bit, by itself, with its own gain and its own start. Scope
    track covers a song with overlapping contexts of 23.5 s and one gain for the song, which takes about a tenth of
    the time; docs/archive/decisions.md has the differences. The weights are OpenAI's, under a Noncommercial Use
    License.

    Attributes
    ----------
    weights
        Folder with OpenAI's two files. Default: $DANCEDATA_JUKEBOX.
    weights_sha256
        Hash that identifies the weights. A build fills it in; if it is given, the weights must match.
    layer
        1 to 72; EDGE uses 66.
    precision
        Type of weights and products; the residual stream is always float32. "auto": fp16 on CUDA, fp32 on a CPU;
        a build records the resolved value.
    overlap_s
        Scope track: least overlap of adjacent contexts in seconds.
    device
        Such as "cuda:1" or "cpu"; "auto": every card, one process each, else the CPU. It affects the numbers only
        through the precision.
    batch_size
        Windows at once; 0: as many as fit into the device's free memory.
    """

    packages: ClassVar[tuple[str, ...]] = ("torch", "soxr")

    weights: Path | None = field(default=None, metadata={"path": True})
    weights_sha256: str = ""
    layer: int = 66
    precision: Precision = "auto"
    overlap_s: float = 4.0
    device: str = field(default="auto", metadata={"path": True})
    batch_size: int = field(default=0, metadata={"path": True})

    def __post_init__(self) -> None:
        if self.layer < 1 or self.batch_size < 0:
            raise UsageError("jukebox: invalid value for layer or batch_size",
                             found=f"layer {self.layer}, batch_size {self.batch_size}",
                             allowed="layer from 1, batch_size from 0")  # fmt: skip

    @override
    def with_weights(self, folder: Path) -> Jukebox:
        return replace(self, weights=folder)

    @property
    @override
    def columns(self) -> Columns:
        return Columns((Group(f"layer{self.layer}", self._config.width, "1"),))

    @property
    @override
    def dtype(self) -> Literal["float32", "float16"]:
        return "float16"

    @override
    def resolved(self, hash_file: Callable[[Path], str]) -> Jukebox:
        """Return the feature with the precision and the hash of the weights resolved."""
        require("jukebox", what="the audio feature jukebox")
        from dancedata.audio.networks.devices import resolve_precision

        folder = self.weights_path()
        device = self.checked_device()
        sha256 = self.checked_hash(hash_file)
        require_layers((self.layer,), config_of(folder).depth)
        precision: Any = resolve_precision(self.precision, device)
        return replace(self, weights=folder, weights_sha256=sha256, precision=precision)

    @override
    def weights_path(self) -> Path:
        folder = self.weights or _named_folder()
        if folder is None:
            raise UsageError("jukebox: the folder of the weights is unknown (they are not part of this package)",
                             fix=f"set {ENVIRONMENT}, or audio.jukebox.weights in the recipe, to the folder that "
                             "`dancedata pull jukebox` wrote")  # fmt: skip
        if not folder.is_dir():
            raise SourceError("the folder of Jukebox's weights does not exist", where=folder)
        return folder.absolute()

    @override
    def weights_hash(self, hash_file: Callable[[Path], str]) -> str:
        folder = self.weights_path()
        return json_sha256({"files": checkpoint_sha256(folder, hash_file), "config": config_of(folder).to_json()})

    @override
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        config = self._config
        contexts_of(1, n_ctx=config.n_ctx, code_rate=config.code_rate, fps=grid.rate, overlap_s=self._overlap)
        codes = resampled_length(n_samples, sample_rate, config.sample_rate) // config.hop
        return n_frames(codes, grid.rate, config.code_rate)

    @override
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> npt.NDArray[Any]:
        """Embed a whole song; "short_audio": less than one code, 128 samples at 44.1 kHz."""
        encoder, config = self._encoder(self._config.n_ctx), self._config
        audio = prepare(signal.samples, signal.sample_rate, config)
        n_codes = len(audio) // config.hop
        parts = contexts_of(
            n_codes, n_ctx=config.n_ctx, code_rate=config.code_rate, fps=grid.rate, overlap_s=self._overlap
        )
        clips = [audio[p.first_code * config.hop : (p.first_code + p.n_codes) * config.hop] for p in parts[:-1]]
        # The last one includes the samples after the last whole code, as a clip does.
        clips.append(audio[parts[-1].first_code * config.hop :])
        with self.all_cores():
            embedded = encoder.embed_prepared(clips, float(grid.rate), batch_size=self.batch_size or None)
        rows = [one[self.layer][p.keep_from : p.keep_to] for p, one in zip(parts, embedded, strict=True)]
        return self._stored(np.concatenate(rows))

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
        """Embed windows, each by itself, as EDGE does; "long_audio": more than 23.78 s."""
        self.require_windows(signal, starts, n_samples)
        clips = [pcm16(signal.samples[start : start + n_samples]) for start in starts]
        codes = resampled_length(n_samples, signal.sample_rate, self._config.sample_rate) // self._config.hop
        with self.all_cores():
            embedded = self._encoder(codes).embed_batch(
                clips, signal.sample_rate, float(grid.rate), batch_size=self.batch_size or None
            )
        rows = [one[self.layer][:n_rows] for one in embedded]
        self.require_rows(min(map(len, rows), default=n_rows), n_rows, grid)
        width = self._config.width
        return self._stored(np.stack(rows) if rows else np.empty((0, n_rows, width), np.float32))

    @property
    def _overlap(self) -> Fraction:
        return Fraction(str(self.overlap_s))

    @property
    def _config(self) -> JukeboxConfig:
        folder = self.weights or _named_folder()
        return _cached_config(folder) if folder is not None else JukeboxConfig()

    def _encoder(self, n_codes: int) -> JukeboxEncoder:
        """Return the network, with tables for clips of up to `n_codes` codes."""
        require("jukebox", what="the audio feature jukebox")
        from dancedata.audio.jukebox.encoder import JukeboxEncoder
        from dancedata.audio.jukebox.network.memory import padded_length

        device = self.device_of_process()
        # Rounded up to whole rows: the same length for songs of all sample rates.
        longest = min(padded_length(self._config, max(n_codes, 1)), self._config.n_ctx)
        folder = self.weights_path()
        how: Any = {"layers": (self.layer,), "device": device, "precision": self.precision, "max_codes": longest}
        return self.network(
            (folder, self.layer, self.precision, device, longest), lambda: JukeboxEncoder(folder, **how)
        )

    def _stored(self, rows: npt.NDArray[np.float32]) -> npt.NDArray[np.float16]:
        return self.in_dtype(rows, "choose another layer")


# `columns` is read once per clip.
_cached_config = lru_cache(maxsize=8)(config_of)


def _named_folder() -> Path | None:
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else None


@dataclass(frozen=True)
class Context:
    """A part of a song that the transformer processes at once.

    `first_code`, `n_codes`: Codes of the song.
    `first_row`: Row of the song at the beginning of the context.
    `keep_from`, `keep_to`: Rows of the context that become rows of the song.
    """

    first_code: int
    n_codes: int
    first_row: int
    keep_from: int
    keep_to: int


def unit_of(code_rate: Fraction, fps: Fraction) -> tuple[int, int]:
    """Return the least numbers of codes and of rows of equal duration: 735 and 64 at 30 rows per second."""
    return FrameGrid(code_rate).common_period(FrameGrid(fps))


def contexts_of(
    n_codes: int, *, n_ctx: int, code_rate: Fraction, fps: Fraction, overlap_s: Fraction
) -> list[Context]:
    """Cut a song's codes into contexts that overlap by at least `overlap_s`.

    Each begins at an instant of both a code and a row. Except in the song's first context, the first rows are warm-up
    and dropped; except in its last one, a short tail is dropped too. The rows that are kept join without a gap.

    Raises UsageError: if a context is too short for the overlap, or for one unit of codes and rows.
    """
    codes, rows = unit_of(code_rate, fps)
    per_context = n_ctx // codes
    grid = FrameGrid(fps)
    tail = grid.frames_up(TAIL_S)
    overlap = FrameGrid(fps / rows).frames_up(overlap_s)
    if per_context < 1:
        raise UsageError(
            "jukebox: contexts cannot overlap at this frame rate: codes and rows do not coincide within a context",
            found=f"{fps} rows per second, {codes} codes to {rows} rows",
            allowed=f"rates at which they coincide within {n_ctx} codes, such as 30, 60, 25 or 24",
        )
    if overlap >= per_context or overlap * rows <= tail:
        raise UsageError("jukebox: invalid value for overlap_s",
                         found=f"{float(overlap_s):g} s at {fps} rows per second",
                         allowed=f"above {float(grid.seconds(tail)):.2f} s and below "
                         f"{float(grid.seconds((per_context - 1) * rows)):.2f} s, in a context of "
                         f"{float(grid.seconds(per_context * rows)):.2f} s")  # fmt: skip
    contexts = []
    step = per_context - overlap
    first = 0
    while True:
        begin = first * codes
        last = begin + per_context * codes >= n_codes
        length = min(per_context * codes, n_codes - begin)
        n_rows = FrameGrid(code_rate).rows_up(length, of=grid)
        keep_from = 0 if first == 0 else overlap * rows - tail
        contexts.append(Context(begin, length, first * rows, keep_from, n_rows if last else n_rows - tail))
        if last:
            return contexts
        first += step

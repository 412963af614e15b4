"""Jukebox embeddings of clips."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from dancedata.audio.jukebox.clips import (
    TooLong,
    fitted,
    n_frames,
    prepare,
    require_audio,
    require_codes,
    require_length,
    require_max_codes,
    resampling_matrix,
)
from dancedata.audio.jukebox.config import require_layers
from dancedata.audio.jukebox.network import memory
from dancedata.audio.jukebox.weights.folder import config_of
from dancedata.audio.jukebox.weights.loading import load_encoder, load_prior, open_openai
from dancedata.audio.networks.devices import (
    Batches,
    compute_dtype,
    exact_float32,
    free_memory,
    require_device,
    resolve_precision,
)
from dancedata.core.errors import DanceDataError, UsageError

Features = dict[int, NDArray[np.float32]]

_DEFAULT_LAYER = 66
_MAX_MATRICES = 4


class JukeboxEncoder:
    """Turns clips of music into activations of Jukebox's 5b prior.

    Every clip is encoded by itself, with its own gain and its own time from 0. Clips do not influence each other,
    whatever the batches.

    Parameters
    ----------
    folder
        With OpenAI's vqvae.pth.tar and prior_level_2.pth.tar; only the tensors that the layers need are read. Files
        of another network have its sizes beside them, in sizes.json.
    layers
        From 1 on, any subset in any order. Default: 66, or the highest that the folder has.
    device
        Such as "cuda:1"; None: CUDA if there is a card, else the CPU.
    precision
        "auto" (fp16 on CUDA, fp32 elsewhere), "fp32", "fp16" or "bf16": type of weights and matrix products. The
        residual stream, norms and softmax are always fp32.
    max_codes
        Length of the longest clip, in codes; position tables are loaded up to it. None: the whole context, 8192.
    memory_budget
        Bytes that may be used on the device. Blocks that do not fit stay on the host and are copied when they are
        needed. None: the free memory of a card, no limit on a CPU.

    Raises
    ------
    SourceError
        A file or tensor is missing, truncated, of another shape, or of another network.
    UsageError
        A parameter is out of range, or the memory of the device is too small.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        layers: Iterable[int] | None = None,
        device: str | torch.device | None = None,
        precision: str = "auto",
        max_codes: int | None = None,
        memory_budget: int | None = None,
    ) -> None:
        folder = Path(folder)
        self.config = config_of(folder)
        highest = self.config.depth
        self.layers = require_layers((min(_DEFAULT_LAYER, highest),) if layers is None else layers, highest)
        checkpoint = open_openai(folder, self.config)
        self.device = require_device(device)
        self.precision = resolve_precision(precision, self.device)
        self.max_codes = require_max_codes(max_codes, self.config)
        self._budget = free_memory(self.device) if memory_budget is None else memory_budget
        dtype = compute_dtype(self.precision)
        self.placement = memory.place(self.config, max(self.layers), dtype, self.max_codes, self._budget)
        self._vqvae = load_encoder(checkpoint, self.config, self.device)
        self._prior = load_prior(
            checkpoint, self.config, self.placement, max_codes=self.max_codes, precision=dtype, device=self.device
        )
        self._batches = Batches(
            "end other programs on the device, or load with a smaller memory_budget, which keeps blocks on the host"
        )
        self._matrices: dict[tuple[int, int], torch.Tensor] = {}

    def __repr__(self) -> str:
        return f"JukeboxEncoder(layers={self.layers}, {self.precision} on {self.device})"

    def encode(self, samples: ArrayLike, sample_rate: int) -> NDArray[np.int64]:
        """Encode a clip of any length as VQ-VAE codes (n,), one per 128 samples at 44.1 kHz.

        `samples`: (m,) or (channels, m) floating point; averaged, resampled and divided by the largest value.
        `sample_rate`: In Hz.
        Raises DataError: "empty_audio", "nan", or "short_audio" (under 128 samples).
        """
        return self._encode_prepared([prepare(samples, sample_rate, self.config)])[0]

    def activations(self, codes: ArrayLike) -> Features:
        """Compute the residual stream of one clip after each of `layers`.

        `codes`: (n,) integers, n up to `max_codes`.
        Returns: (n, W) by layer.
        Raises DataError: "short_audio" (no code) or "long_audio" (more than `max_codes`).
        Raises JukeboxOverflowError: In fp16, a value left the range of its type; the message suggests another
            precision.
        """
        checked = require_codes(codes, self.config)
        require_length(len(checked), self.max_codes, self.config)
        return self._in_batches([checked], None, 1)[0]

    def __call__(
        self, samples: ArrayLike, sample_rate: int, fps: float = 30, *, too_long: TooLong = "error"
    ) -> Features:
        """Embed one clip: encode, compute the layers, resample them to `fps`.

        `samples`, `sample_rate`: As for `encode`.
        `fps`: Frames per second.
        `too_long`: How to treat a clip of more than `max_codes` codes (23.78 s): "error", or "truncate": the rest is
            dropped, as the reference does silently.
        Returns: (T, W) by layer; T = ceil(n fps / 344.53125) for n codes: 150 for 5 s at 30.
        """
        return self.embed_batch([samples], sample_rate, fps, too_long=too_long)[0]

    def embed_batch(
        self,
        clips: Sequence[ArrayLike],
        sample_rate: int,
        fps: float = 30,
        *,
        batch_size: int | None = None,
        too_long: TooLong = "error",
    ) -> list[Features]:
        """Embed several clips of any lengths as `__call__` does.

        `batch_size`: Most clips at once; None: from the free memory (1 on a CPU). Halved when the device runs out of
            memory.
        """
        prepared = [
            fitted(prepare(clip, sample_rate, self.config), self.max_codes, self.config, too_long) for clip in clips
        ]
        return self._embed_prepared(prepared, fps, batch_size)

    def embed_prepared(
        self, clips: Sequence[NDArray[np.float32]], fps: float = 30, *, batch_size: int | None = None
    ) -> list[Features]:
        """Embed prepared clips, such as parts of a song that was prepared as a whole and has one gain.

        `clips`: Each (n,) float32 at the config's sample rate, as `clips.prepare` returns it.
        Raises DataError: "short_audio" for less than one code, "long_audio" for more than `max_codes`.
        """
        for clip in clips:
            require_audio(len(clip), self.config)
            require_length(len(clip) // self.config.hop, self.max_codes, self.config)
        return self._embed_prepared(clips, fps, batch_size)

    def _embed_prepared(
        self, clips: Sequence[NDArray[np.float32]], fps: float, batch_size: int | None
    ) -> list[Features]:
        if not fps > 0:
            raise UsageError("jukebox: invalid value for fps", found=fps, allowed="a number above 0")
        codes = [one[: self.max_codes] for one in self._encode_prepared(clips, batch_size)]
        return self._in_batches(codes, fps, batch_size)

    def batch_size(self, n_codes: int) -> int:
        """Return how many clips of `n_codes` codes fit on the device; 1 on a CPU, where more are not faster."""
        free = None if self._budget is None else self._budget - self.placement.weight_bytes
        if self.device.type != "cuda":
            free = None
        return memory.batch_size(self.config, compute_dtype(self.precision), n_codes, free)

    def _encode_prepared(
        self, clips: Sequence[NDArray[np.float32]], batch_size: int | None = None
    ) -> list[NDArray[np.int64]]:
        codes: list[NDArray[np.int64]] = []
        for length, group in groupby(clips, len):
            size = self.batch_size(length // self.config.hop) if batch_size is None else batch_size
            for part in self._batches.run(list(group), size, self._encode_equal):
                codes.extend(part)
        return codes

    @torch.inference_mode()
    def _encode_equal(self, clips: Sequence[NDArray[np.float32]]) -> list[NDArray[np.int64]]:
        audio = torch.from_numpy(np.stack(clips)).to(self.device)
        return list(self._vqvae(audio).cpu().numpy())

    def _in_batches(
        self, codes: Sequence[NDArray[np.int64]], fps: float | None, batch_size: int | None
    ) -> list[Features]:
        """Compute the layers of all clips, at `fps` or (None) at one row per code."""
        if not codes:
            return []
        # Clips of similar length together, for the least padding.
        order = sorted(range(len(codes)), key=lambda i: len(codes[i]))
        results: dict[int, Features] = {}
        in_order = [codes[i] for i in order]
        size = self.batch_size(len(in_order[-1])) if batch_size is None else batch_size
        for features in self._batches.run(in_order, size, lambda part: self._compute(part, fps)):
            results.update(zip(order[len(results) :], features, strict=False))
        return [results[i] for i in range(len(codes))]

    @torch.inference_mode()
    def _compute(self, codes: Sequence[NDArray[np.int64]], fps: float | None) -> list[Features]:
        lengths = [len(one) for one in codes]
        padded = np.zeros((len(codes), max(lengths)), dtype=np.int64)
        for row, one in zip(padded, codes, strict=True):
            row[: len(one)] = one
        activations: dict[int, list[NDArray[np.float32]]] = {}
        with exact_float32():
            for layer, h, largest_key in self._prior.run(torch.from_numpy(padded).to(self.device)):
                if layer in self.layers:
                    self._require_finite(layer, h, lengths, largest_key)
                    activations[layer] = [self._rows(h[i, :n], fps) for i, n in enumerate(lengths)]
        return [{layer: activations[layer][i] for layer in self.layers} for i in range(len(codes))]

    def _rows(self, h: torch.Tensor, fps: float | None) -> NDArray[np.float32]:
        """(n, W) of one clip on the device -> (n, W) or (T, W), copied to the host."""
        if fps is None:
            return h.cpu().numpy().copy()
        n_codes = len(h)
        frames = n_frames(n_codes, fps, self.config.code_rate)
        return (self._matrix(n_codes, frames) @ h).cpu().numpy()

    def _matrix(self, n_codes: int, frames: int) -> torch.Tensor:
        """Return the resampling matrix on the device; the latest ones are cached, 1 MB for a 5-s clip."""
        key = (n_codes, frames)
        if key not in self._matrices:
            if len(self._matrices) == _MAX_MATRICES:
                self._matrices.pop(next(iter(self._matrices)))
            self._matrices[key] = torch.tensor(resampling_matrix(n_codes, frames), device=self.device)
        return self._matrices[key]

    def _require_finite(
        self, layer: int, h: torch.Tensor, lengths: Sequence[int], largest_key: torch.Tensor | None
    ) -> None:
        finite = torch.stack([torch.isfinite(h[i, :n]).all() for i, n in enumerate(lengths)])
        if largest_key is not None:
            finite &= torch.isfinite(largest_key)
        if not finite.all():
            raise overflow(layer, self.precision)


class JukeboxOverflowError(DanceDataError):
    """An activation is not a finite number; the results must not be used."""


def overflow(layer: int, precision: str) -> JukeboxOverflowError:
    """Return the error for values that are not finite, at `layer` or before."""
    return JukeboxOverflowError(
        f"jukebox: activations up to layer {layer} are not finite",
        found=f"infinity or NaN, in precision {precision}",
        fix='start again with precision "bf16" (or "fp32") for all clips: a dataset should have one precision only'
        if precision == "fp16"
        else "check the weights: values within the range of float32 do not overflow in this precision",
    )

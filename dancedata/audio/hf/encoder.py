"""Frames and rows of signals from a network: chunks, equal ones batched, their frames brought to a recipe's rows."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby, product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from dancedata.audio.hf.families.base import Chunk, Prepared, chunks_of
from dancedata.audio.hf.loading import load_network, place
from dancedata.audio.hf.rows import RowMap, RowSum, frames_of, method_of, row_map
from dancedata.audio.hf.settings import Settings
from dancedata.audio.networks.devices import Batches, compute_dtype, exact_float32, require_device
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.kernel import resample

#: Chunks at once on a card, where a recipe does not say; halved where its memory runs out.
_BATCH = 16
_SMALLER = "set a smaller chunk_s, or compute on the CPU (device: cpu)"

Finish = Callable[[npt.NDArray[np.float32]], npt.NDArray[Any]]


@dataclass(frozen=True)
class FramesOfSignal:
    """Frames (K, D) float32 at an encoder's own rate, and the time of each in seconds, (K,)."""

    values: npt.NDArray[np.float32]
    stamps_s: npt.NDArray[np.float64]


class HuggingFaceEncoder:
    """An encoder of the Hugging Face layout, on a device.

    `settings`: The model, and what of it is taken.
    `device`: Such as "cuda:1"; None: CUDA if there is a card, else the CPU.
    `precision`: "fp32", "fp16" or "bf16".
    `weight_budget`: Bytes that the weights may take on the device; the rest stays on the host. None: what is free.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        device: str | None = None,
        precision: str = "fp32",
        weight_budget: int | None = None,
    ) -> None:
        self.settings = settings
        self.device = require_device(device)
        self.precision = precision
        self._dtype = compute_dtype(precision)
        network = load_network(settings.folder, settings.family, max(settings.layers), settings.output, self._dtype)
        self._network = place(network, self.device, weight_budget)
        self._batches = Batches(_SMALLER)

    def __repr__(self) -> str:
        return f"HuggingFaceEncoder({Path(self.settings.folder.source).name!r}, {self.precision} on {self.device})"

    def frames(self, samples: npt.NDArray[np.float32], sample_rate: int) -> FramesOfSignal:
        """Compute the frames of a signal (n,) at the encoder's own rate; DataError "short_audio" or "overflow"."""
        resampled = resample(samples, sample_rate, self.settings.family.sample_rate)
        chunks = self._chunks(len(resampled))
        grid = FrameGrid(Fraction(1))  # the frames alone are used, not the rows
        kept = frames_of(chunks, self._counts(chunks), self.settings.family.timing, grid)
        outputs = [values for _, _, values in self._run([resampled], chunks, None)]
        values = np.concatenate([v[kept.number[kept.chunk == k].astype(int)] for k, v in enumerate(outputs)])
        return FramesOfSignal(values, np.asarray(kept.stamp / kept.ticks, dtype=np.float64))

    def rows(
        self,
        signals: Sequence[npt.NDArray[np.float32]],
        sample_rate: int,
        grid: FrameGrid,
        n_rows: int,
        *,
        finish: Finish,
        batch_size: int | None = None,
    ) -> list[npt.NDArray[Any]]:
        """Compute rows of signals (n,) of equal length, each by itself; errors as of `frames`."""
        family = self.settings.family
        resampled = [resample(samples, sample_rate, family.sample_rate) for samples in signals]
        chunks = self._chunks(len(resampled[0]))
        kept = frames_of(chunks, self._counts(chunks), family.timing, grid)
        method = method_of(self.settings.resample, family.timing, grid, codes=self.settings.output == "codes")
        weights: RowMap = row_map(kept, n_rows, method)
        sums = [RowSum(weights, self.settings.width, finish) for _ in resampled]
        for number, signal, values in self._run(resampled, chunks, batch_size):
            sums[signal].add(number, values)
        return [one.result() for one in sums]

    def _chunks(self, n_samples: int) -> list[Chunk]:
        settings = self.settings
        if n_samples < settings.family.min_samples:
            raise DataError("hf: the signal is shorter than a frame of the encoder", reason="short_audio",
                            found=f"{n_samples} samples at {settings.family.sample_rate} Hz",
                            allowed=f"at least {settings.family.min_samples}")  # fmt: skip
        return chunks_of(
            n_samples,
            length=settings.chunk_samples,
            overlap=settings.overlap_samples,
            unit=settings.family.unit,
            timing=settings.family.timing,
        )

    def _counts(self, chunks: Sequence[Chunk]) -> list[int]:
        return [self.settings.family.n_frames(chunk.n_samples) for chunk in chunks]

    def _run(
        self, signals: Sequence[npt.NDArray[np.float32]], chunks: Sequence[Chunk], batch_size: int | None
    ) -> Iterator[tuple[int, int, npt.NDArray[np.float32]]]:
        """Yield the numbers of a chunk and a signal, and its frames (K, D), in order. Equal chunks are batched."""
        normalize = self.settings.normalize == "extractor"
        prepared = [self.settings.family.prepared(samples, normalize=normalize) for samples in signals]
        # The first chunks of all signals, then the second ones: those are equally long.
        parts = product(range(len(chunks)), range(len(signals)))
        size = batch_size or (_BATCH if self.device.type == "cuda" else 1)
        for _, equal in groupby(parts, key=lambda part: chunks[part[0]].n_samples):
            batch = list(equal)
            begin = 0
            for values in self._batches.run(batch, size, lambda members: self._compute(prepared, chunks, members)):
                for (number, signal), frames in zip(batch[begin : begin + len(values)], values, strict=True):
                    yield number, signal, frames
                begin += len(values)

    @torch.inference_mode()
    def _compute(
        self, prepared: Sequence[Prepared], chunks: Sequence[Chunk], parts: Sequence[tuple[int, int]]
    ) -> list[npt.NDArray[np.float32]]:
        settings = self.settings
        arrays = [prepared[signal](chunks[number].start, chunks[number].n_samples) for number, signal in parts]
        inputs = torch.from_numpy(np.stack(arrays)).to(self.device, self._dtype)
        with exact_float32():
            hidden = settings.family.frames(self._network, inputs, settings.output, settings.layers)
        layers = [hidden[layer].float() for layer in settings.layers]
        joined = torch.stack(layers).mean(dim=0) if settings.reduce == "mean" else torch.cat(layers, dim=-1)
        if not bool(torch.isfinite(joined).all()):
            raise DataError(
                "hf: the network's numbers are not finite",
                reason="overflow",
                found=f"infinity or NaN, in precision {self.precision}",
                fix="start again with precision fp32 for all songs: a dataset should have one precision only"
                if self.precision != "fp32"
                else "check the weights: numbers within float32 do not overflow in this precision",
            )
        return list(joined.cpu().numpy())

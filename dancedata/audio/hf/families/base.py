"""Family: arithmetic on the config of an encoder, and loading and calling its network."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import SourceError
from dancedata.core.text import quoted

if TYPE_CHECKING:
    import torch

    #: Frames (B, K, D) by layer; an output without layers has the key 0.
    Frames = dict[int, torch.Tensor]


@dataclass(frozen=True)
class Timing:
    """Instants of the frames of an encoder, in samples at the encoder's rate.

    `hop`: From one frame to the next.
    `first_centre`: Centre of the first frame, counted from the first sample that the encoder is given.
    """

    sample_rate: int
    hop: Fraction
    first_centre: Fraction

    @property
    def rate(self) -> Fraction:
        """Frames per second."""
        return self.sample_rate / self.hop


@dataclass(frozen=True)
class Chunk:
    """A part of a signal that the encoder processes at once.

    `keep_from`, `keep_to`: Its frames between these times, in samples of the signal, are kept; None: no limit.
    """

    start: int
    n_samples: int
    keep_from: Fraction | None
    keep_to: Fraction | None


def chunks_of(n_samples: int, *, length: int, overlap: int, unit: int, timing: Timing) -> list[Chunk]:
    """Cut a signal into chunks of `length` samples that overlap by at least `overlap`.

    All begin at a multiple of `unit` samples. The last one ends with the signal and is as long as the others, or up
    to `unit` - 1 samples shorter, so that all of its frames see enough of their past. In the
    middle of an overlap the earlier chunk's frames end and the later one's begin, at the border of two frames.

    `length`, `overlap`: Multiples of `unit`.
    """
    if n_samples <= length:
        return [Chunk(0, n_samples, None, None)]
    last = -(-(n_samples - length) // unit) * unit
    starts = [*range(0, last, length - overlap), last]
    borders = [_border(timing, later, Fraction(later + earlier + length, 2)) for earlier, later in pairwise(starts)]
    return [
        Chunk(start, min(length, n_samples - start), keep_from, keep_to)
        for start, keep_from, keep_to in zip(starts, [None, *borders], [*borders, None], strict=True)
    ]


def _border(timing: Timing, start: int, near: Fraction) -> Fraction:
    """Return the border of two frames of a chunk that is nearest to a time."""
    first = start + timing.first_centre - timing.hop / 2
    return first + round((near - first) / timing.hop) * timing.hop


def hidden_states(
    network: Any, inputs: torch.Tensor, blocks: Sequence[torch.nn.Module], layers: Sequence[int], n_layers: int
) -> Frames:
    """Run a network, and return the hidden states of some layers.

    Layer 0 is what enters the first block, layer k what leaves block k, and layer `n_layers` the network's last
    hidden state, after a final norm where it has one. They are captured here because what
    ``output_hidden_states`` returns last differs between versions of transformers.
    """
    states: Frames = {}

    def before(_module: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        states[0] = args[0] if args else kwargs["hidden_states"]

    def after(layer: int) -> Callable[..., None]:
        def keep(_module: Any, _args: Any, output: Any) -> None:
            states[layer] = output[0] if isinstance(output, tuple) else output

        return keep

    with ExitStack() as hooks:
        for layer in set(layers) - {n_layers}:
            if layer == 0:
                hooks.callback(blocks[0].register_forward_pre_hook(before, with_kwargs=True).remove)
            else:
                hooks.callback(blocks[layer - 1].register_forward_hook(after(layer)).remove)
        last = network(inputs).last_hidden_state
    if n_layers in layers:
        states[n_layers] = last
    return states


#: Limits that no model reaches: without them a config of a few bytes could take all memory.
MAX_SIZE, MAX_BLOCKS = 1 << 20, 1000
Output = Literal["hidden", "embedding", "codes"]
Samples = npt.NDArray[np.float32]


@dataclass(frozen=True)
class NetworkSpec:
    """The class of transformers that loads a folder, and permitted differences of the weights.

    `config`: Name of its config class, and the keys for it.
    `missing`, `unexpected`: Regular expressions of weights that the features do not need: those may be missing, or
        present but unused.
    `renamed`: Regular expressions of names in the files, with what they are in the class.
    """

    model: str
    config: tuple[str, dict[str, Any]]
    missing: tuple[str, ...] = ()
    unexpected: tuple[str, ...] = ()
    renamed: Mapping[str, str] = field(default_factory=dict)


#: Returns what the network is given for a chunk, from its first sample and length: an array without a batch axis.
Prepared = Callable[[int, int], npt.NDArray[np.float32]]


def waveform(samples: Samples) -> Prepared:
    """Return the chunks of a normalised signal, (n,) or (channels, n), as they are."""
    return lambda start, n_samples: samples[..., start : start + n_samples]


@dataclass(frozen=True)
class Family(ABC):
    """Encoders of one kind. All but `prepared` and `frames` is arithmetic on the config.

    `extractor`: preprocessor_config.json.
    `outputs`: What it offers, the default first.
    `depth`, `size`: Keys of the config with the number of blocks and the columns of a layer, each with its default.
    """

    name: ClassVar[str]
    model_types: ClassVar[tuple[str, ...]]
    version: ClassVar[int] = 1
    outputs: ClassVar[tuple[Output, ...]] = ("hidden",)
    depth: ClassVar[tuple[str, int]] = ("num_hidden_layers", 12)
    size: ClassVar[tuple[str, int]] = ("hidden_size", 768)
    chunk_s: ClassVar[float] = 30.0
    overlap_s: ClassVar[float] = 4.0

    config: Mapping[str, Any]
    extractor: Mapping[str, Any]

    @property
    def encoder_config(self) -> Mapping[str, Any]:
        """The part of the config that describes the encoder."""
        inner = self.config.get("audio_config")
        return inner if isinstance(inner, Mapping) else self.config

    @property
    def sample_rate(self) -> int:
        """Samples per second that the network is given: by default as preprocessor_config.json states."""
        if "sampling_rate" not in self.extractor:
            raise SourceError(
                "hf: the sampling rate of the model is unknown",
                found="no preprocessor_config.json with sampling_rate",
                fix='copy that file from the model\'s page, or write one: {"sampling_rate": 16000, "do_normalize": '
                "true} with the model's values",
            )
        return self.number("sampling_rate", of=self.extractor)

    @property
    @abstractmethod
    def timing(self) -> Timing:
        """Instants of its frames."""

    @property
    def n_layers(self) -> int:
        """Number of blocks L: layer 0 is the input of the first one, layer L the output of the network."""
        key, default = self.depth
        return self.number(key, of=self.encoder_config, default=default, most=MAX_BLOCKS)

    @abstractmethod
    def n_frames(self, n_samples: int) -> int:
        """Return how many frames a chunk of `n_samples` samples has."""

    def width(self, output: Output) -> int:
        """Return the columns of one layer, or of an output without layers."""
        key, default = self.size
        return self.number(key, of=self.encoder_config, default=default)

    @property
    def max_rate(self) -> Fraction:
        """Frames per second of the densest step: the network's frames, or the spectrogram that it is given."""
        return self.timing.rate

    @property
    def min_samples(self) -> int:
        """The fewest samples that give a frame."""
        return int(self.timing.hop)

    @property
    def unit(self) -> int:
        """Chunks begin at multiples of this many samples."""
        return int(self.timing.hop) if self.timing.hop.denominator == 1 else 1

    @property
    def max_chunk(self) -> int | None:
        """The most samples of a chunk; None: any number."""
        return None

    @property
    def fixed_chunk(self) -> int | None:
        """Samples of every chunk, where the network takes no other number; None where it does."""
        return None

    @property
    def layers(self) -> range:
        """Layers that `layers` may name."""
        return range(self.n_layers + 1)

    def prepared(self, samples: Samples, *, normalize: bool) -> Prepared:
        """Return what cuts chunks from a signal (n,) at `sample_rate`, normalised as the extractor does it."""
        return waveform(samples)

    @abstractmethod
    def network(self, top: int) -> NetworkSpec:
        """Return how the network is loaded with its blocks up to layer `top`."""

    def keys(self, **changed: Any) -> dict[str, Any]:
        """Return the keys of the encoder's config class, some of them changed."""
        return {k: v for k, v in self.encoder_config.items() if k != "model_type"} | changed

    def above(self, top: int, blocks: str) -> tuple[str, ...]:
        """Return regular expressions of the weights of blocks above layer `top`; `blocks` matches all blocks."""
        return tuple(rf"{blocks}\.{k}\..*" for k in range(max(top, 1), self.n_layers))

    def slimmed(self, network: Any, output: Output) -> Any:
        """Return the loaded network without the parts that the features do not need."""
        return network

    def blocks(self, network: Any) -> Any:
        """Return the blocks of the loaded network."""
        return network.encoder.layers

    def frames(self, network: Any, inputs: torch.Tensor, output: Output, layers: tuple[int, ...]) -> Frames:
        """Return the frames of inputs that are stacked into a batch; the network is never given a mask."""
        return hidden_states(network, inputs, self.blocks(network), layers, self.n_layers)

    def number(
        self, key: str, *, of: Mapping[str, Any] | None = None, default: int | None = None, most: int = MAX_SIZE
    ) -> int:
        """Return a whole number from 1 to `most` of the config; SourceError if it has another value."""
        value = (self.config if of is None else of).get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:
            raise SourceError(f"hf: the config of a {self.name} model has no valid {key}", found=quoted(value),
                              allowed=f"a whole number from 1 to {most:,}")  # fmt: skip
        return value

    def sizes(self, key: str, default: tuple[int, ...]) -> tuple[int, ...]:
        """Return a list of whole numbers above 0 of the config; SourceError if it is something else."""
        value = self.config.get(key, default)
        plain = isinstance(value, list | tuple) and 0 < len(value) <= MAX_BLOCKS
        if not plain or not all(type(v) is int and v > 0 for v in value) or math.prod(value) > MAX_SIZE:
            raise SourceError(f"hf: the config of a {self.name} model has no valid {key}", found=quoted(value),
                              allowed=f"whole numbers above 0, whose product is at most {MAX_SIZE:,}")  # fmt: skip
        return tuple(value)


def conv_length(n: int, kernels: tuple[int, ...], strides: tuple[int, ...]) -> int:
    """Return how many positions a stack of convolutions without padding has for `n` samples."""
    for kernel, stride in zip(kernels, strides, strict=True):
        n = (n - kernel) // stride + 1 if n >= kernel else 0
    return n


def conv_field(kernels: tuple[int, ...], strides: tuple[int, ...]) -> tuple[int, int]:
    """Return the samples that one position of a stack of convolutions depends on, and the stride."""
    field_size, hop = 1, 1
    for kernel, stride in zip(kernels, strides, strict=True):
        field_size += (kernel - 1) * hop
        hop *= stride
    return field_size, hop


def uniform(sample_rate: int, hop: int, first_centre: Fraction | int) -> Timing:
    """Return the timing of frames that are a whole number of samples apart."""
    return Timing(sample_rate, Fraction(hop), Fraction(first_centre))

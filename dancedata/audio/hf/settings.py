"""Output, layers and chunks of a recipe, checked against the model's config. Needs no torch."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from dancedata.audio.hf.model_folder import ModelFolder
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.text import quoted

if TYPE_CHECKING:
    from dancedata.audio.hf.families.base import Family, Output

Layers = int | tuple[int, ...] | str
_RANGE = re.compile(r"(\d+)\.\.(\d+)")
_WORDS = ("last", "all", "mean")
#: Most frames per second of an encoder, or of the spectrogram that it is given (published codecs have up to 150,
#: spectrograms 100), and most of them in a window of fixed length (Whisper has 3,000): a config of a few bytes could
#: take all memory.
MAX_FRAMES_PER_S, MAX_WINDOW_FRAMES = 500, 30_000


@dataclass(frozen=True)
class Settings:
    """A model, the layers or codes that are taken of it, how it is cut into chunks.

    `layers`: In the order of the columns; (0,) of an output without layers.
    `chunk_samples`, `overlap_samples`: At the encoder's rate.
    """

    folder: ModelFolder
    family: Family
    output: Output
    layers: tuple[int, ...]
    reduce: Literal["concat", "mean"]
    chunk_samples: int
    overlap_samples: int
    resample: str
    normalize: str

    @property
    def columns(self) -> Columns:
        """A group for each layer, or one for all."""
        width = self.family.width(self.output)
        if self.output != "hidden":
            return Columns((Group(self.output, width, "1"),))
        if self.reduce == "mean" and len(self.layers) > 1:
            return Columns((Group(f"mean_of_layers_{'_'.join(map(str, self.layers))}", width, "1"),))
        return Columns(tuple(Group(f"layer{layer}", width, "1") for layer in self.layers))

    @property
    def width(self) -> int:
        """Number of columns D."""
        return self.columns.width

    @property
    def chunk_s(self) -> float:
        """Length of a chunk in seconds."""
        return self.chunk_samples / self.family.sample_rate

    @property
    def overlap_s(self) -> float:
        """Overlap of chunks in seconds."""
        return self.overlap_samples / self.family.sample_rate


def settings_of(
    folder: ModelFolder,
    *,
    output: str,
    layers: Layers,
    reduce: Literal["concat", "mean"],
    chunk_s: float | None,
    overlap_s: float | None,
    resample: str,
    normalize: str,
) -> Settings:
    """Check keys of a recipe against a model; UsageError for keys, SourceError for a model that cannot be used."""
    from dancedata.audio.hf.families import family_of

    family = family_of(folder.config, folder.extractor, folder.path)
    _require_moderate(family, folder.path)
    chosen = _output(family, output)
    indices = _layers(family, layers, folder.path) if chosen == "hidden" else _no_layers(family, chosen, layers)
    if layers == "mean":
        reduce = "mean"
    length, overlap = _chunks(family, chunk_s, overlap_s)
    return Settings(folder, family, chosen, indices, reduce, length, overlap, resample, normalize)


def _require_moderate(family: Family, folder: Path) -> None:
    """Raise SourceError for a config by which a song would be cut into far more frames than in any model."""
    rate = family.max_rate
    in_window = (family.fixed_chunk or 0) * rate / family.sample_rate
    if rate > MAX_FRAMES_PER_S or in_window > MAX_WINDOW_FRAMES:
        window = f", {round(in_window):,} of them in a window" if family.fixed_chunk else ""
        raise SourceError(
            f"hf: the config of a {family.name} model gives too many frames",
            where=folder,
            found=f"{float(rate):,.6g} frames per second{window}",
            allowed=f"at most {MAX_FRAMES_PER_S} per second, and {MAX_WINDOW_FRAMES:,} in a window of fixed length",
            fix="check hop_length, the strides and the lengths in config.json and preprocessor_config.json, or fetch "
            "the model again",
        )


def _output(family: Family, output: str) -> Output:
    if output == "auto":
        return family.outputs[0]
    for offered in family.outputs:
        if output == offered:
            return offered
    problem = f"hf: {family.name} models do not have this output"
    raise UsageError(problem, found=output, allowed=", ".join(family.outputs))


def _layers(family: Family, layers: Layers, folder: Path) -> tuple[int, ...]:
    """Return layer numbers from a key: 7, (7, 9), "4..8", "last", "all", "mean"."""
    offered = family.layers
    if isinstance(layers, str):
        span = _RANGE.fullmatch(layers)
        if layers == "last":
            return (offered[-1],)
        if layers in ("all", "mean"):
            return tuple(offered)
        if span is None:
            raise UsageError(
                "hf: invalid value for layers",
                where=folder,
                found=quoted(layers),
                allowed=f"a number, a list of numbers, a range such as 4..8, {', '.join(_WORDS)}",
            )
        # One beyond is enough to be refused; a range of billions is not made.
        indices: Sequence[int] = range(int(span[1]), min(int(span[2]), offered[-1] + 1) + 1)
    else:
        indices = layers if isinstance(layers, tuple) else (layers,)
    # True and 1.0 equal a layer's number.
    wrong = [layer for layer in indices if type(layer) is not int or layer not in offered]
    if wrong or not indices or len(set(indices)) != len(indices):
        raise UsageError(
            "hf: invalid value for layers",
            where=folder,
            found=quoted(layers) if not isinstance(layers, tuple) else str(list(layers)),
            allowed=f"{offered[0]} to {offered[-1]}, each once (0 is what enters the first block)"
            if len(offered) > 1
            else f"{offered[0]}, the last stage: the others of a {family.name} model have other rates",
        )
    return tuple(indices)


def _no_layers(family: Family, output: Output, layers: Layers) -> tuple[int, ...]:
    if layers != "last":
        problem = f"hf: {family.name} models have no layers to choose from"
        raise UsageError(problem, found=str(layers), fix=f"omit layers for {output}")
    return (0,)


def _chunks(family: Family, chunk_s: float | None, overlap_s: float | None) -> tuple[int, int]:
    """Return the length and the overlap of chunks in samples, whole units."""
    rate, unit, fixed, most = family.sample_rate, family.unit, family.fixed_chunk, family.max_chunk
    if fixed is not None:
        if chunk_s is not None and round(chunk_s * rate) != fixed:
            raise UsageError(f"hf: {family.name} models take windows of one length", found=f"chunk_s {chunk_s:g}",
                             fix=f"omit chunk_s: it is {fixed / rate:g}")  # fmt: skip
        length = fixed
    else:
        limit = family.chunk_s if most is None else min(family.chunk_s, most / rate)
        length = round((limit if chunk_s is None else chunk_s) * rate) // unit * unit
        if length > (most or length) or length < max(unit, family.min_samples):
            raise UsageError(
                "hf: invalid value for chunk_s",
                found=f"{chunk_s:g}" if chunk_s is not None else f"{limit:g}",
                allowed=f"{max(unit, family.min_samples) / rate:.3g} s or more"
                + (f", up to {most / rate:g} s" if most else ""),
            )
    default = min(family.overlap_s, length / rate / 5)
    overlap = -(-round((default if overlap_s is None else overlap_s) * rate) // unit) * unit
    if not 0 <= overlap < length:
        raise UsageError("hf: invalid value for overlap_s",
                         found=f"{overlap_s:g}" if overlap_s is not None else f"{default:g}",
                         allowed=f"0 or more, below {length / rate:g} s, the length of a chunk")  # fmt: skip
    return length, overlap

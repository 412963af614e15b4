"""The sizes of a Jukebox network: of its VQ-VAE and of its top-level prior."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from fractions import Fraction
from typing import Any

from dancedata.core.errors import UsageError

# EDGE and jukemirlib label every song with one length, in seconds; the labels of all clips follow from it.
_TOTAL_LENGTH_S = 62


@dataclass(frozen=True)
class JukeboxConfig:
    """Sizes of the level-2 VQ-VAE encoder and of the level-2 prior; the defaults are the real 5b model."""

    downs: tuple[int, ...] = (3, 2, 2)
    conv_width: int = 32
    conv_depth: int = 4
    dilation_growth: int = 3
    code_width: int = 64
    codebook_size: int = 2048
    width: int = 4800
    depth: int = 72
    heads: int = 8
    attn_width: int = 1200
    mlp_width: int = 4800
    n_ctx: int = 8192
    n_rows: int = 128
    n_artists: int = 4111
    n_genres: int = 120
    time_bins: int = 128
    min_duration_s: float = 60.0
    max_duration_s: float = 600.0
    sample_rate: int = 44100

    def __post_init__(self) -> None:
        # JSON has lists; a config is a cache key and must be hashable.
        object.__setattr__(self, "downs", tuple(self.downs))
        for field in fields(self):
            value = getattr(self, field.name)
            if any(v <= 0 for v in (value if isinstance(value, tuple) else (value,))):
                raise UsageError(
                    f"JukeboxConfig: invalid value for {field.name}", found=value, allowed="numbers above 0"
                )
        for whole, part in (("attn_width", "heads"), ("n_ctx", "n_rows")):
            if getattr(self, whole) % getattr(self, part):
                raise UsageError(f"JukeboxConfig: {whole} must be a multiple of {part}",
                                 found=f"{getattr(self, whole)} and {getattr(self, part)}")  # fmt: skip
        if not self.min_duration_s <= _TOTAL_LENGTH_S < self.max_duration_s:
            raise UsageError(
                "JukeboxConfig: the label of the song's length is out of range",
                found=f"{self.min_duration_s} to {self.max_duration_s} s",
                allowed=f"a range that includes {_TOTAL_LENGTH_S} s, the label of every clip",
            )

    @property
    def hop(self) -> int:
        """Samples per code: 128."""
        return int(2 ** sum(self.downs))

    @property
    def code_rate(self) -> Fraction:
        """Codes per second: 44100 / 128 = 344.53125."""
        return Fraction(self.sample_rate, self.hop)

    @property
    def row_length(self) -> int:
        """Codes per row of factored attention: 64."""
        return self.n_ctx // self.n_rows

    @property
    def total_length(self) -> int:
        """The label "length of the song" in samples, the same for every clip: 2,734,080."""
        return _TOTAL_LENGTH_S * self.sample_rate // self.hop * self.hop

    def to_json(self) -> dict[str, Any]:
        """Return the fields as plain JSON values."""
        return {**asdict(self), "downs": list(self.downs)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> JukeboxConfig:
        """Make a config from the result of `to_json`; UsageError for other keys."""
        names = {field.name for field in fields(cls)}
        if set(data) != names:
            raise UsageError(
                "JukeboxConfig: wrong keys", found=sorted(set(data) ^ names), allowed=f"exactly {sorted(names)}"
            )
        return cls(**data)


def require_layers(layers: Iterable[int], highest: int) -> tuple[int, ...]:
    """Return the layers as a tuple; UsageError unless each is within 1 .. highest and occurs once."""
    chosen = tuple(layers)
    valid = all(isinstance(layer, int) and 1 <= layer <= highest for layer in chosen)
    if not chosen or not valid or len(set(chosen)) < len(chosen):
        raise UsageError("jukebox: invalid value for layers", found=chosen,
                         allowed=f"one or more of 1 to {highest}, each once, in any order")  # fmt: skip
    return chosen

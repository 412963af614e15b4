"""The sizes of a Jukebox network: of its VQ-VAE and of its top-level prior."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from fractions import Fraction
from typing import Any

from dancedata.core.errors import UsageError

# EDGE and jukemirlib label every song with one length, in seconds; the labels of all clips follow from it.
_TOTAL_LENGTH_S = 62

# Hyperparameters that change the arithmetic, with the only value that is implemented: that of the 5b model.
_FIXED: dict[str, dict[str, Any]] = {
    "vqvae": {"m_conv": 1.0, "dilation_cycle": None},
    "prior": {
        "attn_order": 2,
        "merged_decoder": True,
        "res_scale": False,
        "pos_init": False,
        "use_tokens": False,
        "n_tokens": 0,
        "labels_v3": False,
    },
}


@dataclass(frozen=True)
class JukeboxConfig:
    """Sizes of the level-2 VQ-VAE encoder and of the level-2 prior; the defaults are the real 5b model.

    `downs`
    `conv_width`, `conv_depth`
    `dilation_growth`
    `code_width`, `codebook_size`
    `width`, `depth`, `heads`
    `attn_width`, `mlp_width`
    `n_ctx`, `n_rows`
    `n_artists`, `n_genres`, `time_bins`
    `min_duration_s`, `max_duration_s`
    `sample_rate`
    """

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

    @classmethod
    def from_hparams(cls, hparams: Mapping[str, Any]) -> JukeboxConfig:
        """Make a config from OpenAI's hyperparameters.

        `hparams`: ``{"vqvae": {"downs_t", "width", "depth", "hvqvae_multipliers", ...}, "prior": {"prior_width",
            "prior_depth", "heads", ...}}``. Names that inference does not use are ignored; those that would change
            the arithmetic must have the value of the 5b model.
        Raises UsageError: A name is missing, or the network is of another kind (lyrics, other attention patterns).
        """
        vqvae, prior = (_part(hparams, name) for name in _FIXED)
        strides = tuple(vqvae["strides_t"])
        if any(stride != 2 for stride in strides):
            raise UsageError("JukeboxConfig: unsupported vqvae.strides_t", found=strides, allowed="2 everywhere")
        level = prior["level"]
        multiplier = vqvae["hvqvae_multipliers"][level]
        n_genres, n_artists = prior["y_bins"]
        return cls(
            downs=tuple(vqvae["downs_t"][: level + 1]),
            conv_width=vqvae["width"] * multiplier,
            conv_depth=vqvae["depth"] * multiplier,
            dilation_growth=vqvae["dilation_growth_rate"],
            code_width=vqvae["emb_width"],
            codebook_size=vqvae["l_bins"],
            width=prior["prior_width"],
            depth=prior["prior_depth"],
            heads=prior["heads"],
            attn_width=_part_of(prior["m_attn"], prior["prior_width"]),
            mlp_width=_part_of(prior["m_mlp"], prior["prior_width"]),
            n_ctx=prior["n_ctx"],
            n_rows=prior["blocks"],
            n_artists=n_artists,
            n_genres=n_genres,
            time_bins=prior["t_bins"],
            min_duration_s=prior["min_duration"],
            max_duration_s=prior["max_duration"],
            sample_rate=prior["sr"],
        )

    def to_hparams(self) -> dict[str, Any]:
        """Return the argument of `from_hparams`; the other levels of the VQ-VAE are only counted."""
        levels = len(self.downs)
        return {
            "vqvae": {
                "downs_t": list(self.downs),
                "strides_t": [2] * levels,
                "emb_width": self.code_width,
                "l_bins": self.codebook_size,
                "hvqvae_multipliers": [1] * levels,
                "width": self.conv_width,
                "depth": self.conv_depth,
                "dilation_growth_rate": self.dilation_growth,
                **_FIXED["vqvae"],
            },
            "prior": {
                "level": levels - 1,
                "n_ctx": self.n_ctx,
                "prior_width": self.width,
                "prior_depth": self.depth,
                "heads": self.heads,
                "blocks": self.n_rows,
                "m_attn": self.attn_width / self.width,
                "m_mlp": self.mlp_width / self.width,
                "y_bins": [self.n_genres, self.n_artists],
                "t_bins": self.time_bins,
                "min_duration": self.min_duration_s,
                "max_duration": self.max_duration_s,
                "sr": self.sample_rate,
                **_FIXED["prior"],
            },
        }

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


_REQUIRED = {
    "vqvae": (
        *("downs_t", "strides_t", "emb_width", "l_bins", "hvqvae_multipliers", "width", "depth"),
        "dilation_growth_rate",
    ),
    "prior": (
        *("level", "n_ctx", "prior_width", "prior_depth", "heads", "blocks", "m_attn", "m_mlp", "y_bins", "t_bins"),
        *("min_duration", "max_duration", "sr"),
    ),
}


def _part_of(ratio: float, width: int) -> int:
    """Return a width given as a ratio: the whole part, as in OpenAI's code, but 4.9999999 is 5."""
    return int(ratio * width + 1e-6)


def require_layers(layers: Iterable[int], highest: int) -> tuple[int, ...]:
    """Return the layers as a tuple; UsageError unless each is within 1 .. highest and occurs once."""
    chosen = tuple(layers)
    valid = all(isinstance(layer, int) and 1 <= layer <= highest for layer in chosen)
    if not chosen or not valid or len(set(chosen)) < len(chosen):
        raise UsageError("jukebox: invalid value for layers", found=chosen,
                         allowed=f"one or more of 1 to {highest}, each once, in any order")  # fmt: skip
    return chosen


def _part(hparams: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Return one of the two parts; UsageError for missing names or another kind of network."""
    part = hparams.get(name)
    if not isinstance(part, Mapping):
        raise UsageError(f"Jukebox hyperparameters: the part {name!r} is missing", found=sorted(map(str, hparams)),
                         allowed="a mapping with the parts 'vqvae' and 'prior'")  # fmt: skip
    missing = [key for key in _REQUIRED[name] if key not in part]
    if missing:
        raise UsageError(f"Jukebox hyperparameters: {name} lacks {', '.join(missing)}", found=sorted(map(str, part)))
    for key, value in _FIXED[name].items():
        if part.get(key, value) != value:
            raise UsageError(f"Jukebox hyperparameters: {name}.{key} belongs to another kind of network",
                             found=part[key], allowed=f"{value} (as in the 5b model without lyrics)")  # fmt: skip
    return part

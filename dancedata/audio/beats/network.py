"""The network of Beat This!: logits of beats and downbeats, 50 per second, from a log-mel spectrum.

Foscarin, Schlueter, Widmer (ISMIR 2024), section 3.2. Modules have the names of the tensors in the published
checkpoints (MIT), so that these are loaded unchanged. It is for inference only and has no dropout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

#: Convolutions of the front end, each of which halves the bands and doubles the channels.
_N_HALVINGS = 3
#: Width of the front end's inner layers, as a multiple of its channels.
_FRONTEND_FACTOR = 4


@dataclass(frozen=True)
class Sizes:
    """Sizes of a network; the defaults are the published large one, ``final0``.

    `stem`: Channels after the first convolution.
    `width`, `inner`, `layers`: Of the transformer: columns, columns of its inner layers, blocks.
    `head`: Columns of an attention head.
    `partial`: Whether the front end attends across bands and across time.
    `summed`: Whether the logit of a beat is the sum of both outputs.
    """

    bands: int = 128
    stem: int = 32
    width: int = 512
    inner: int = 2048
    layers: int = 6
    head: int = 32
    partial: bool = True
    summed: bool = True

    @classmethod
    def of_shapes(cls, shapes: Mapping[str, tuple[int, ...]], summed: bool) -> Sizes:
        """Return the sizes of a network whose tensors have these shapes; KeyError or IndexError if one is missing."""
        blocks = "transformer_blocks.layers."
        return cls(
            bands=shapes["frontend.stem.bn1d.weight"][0],
            stem=shapes["frontend.stem.conv2d.weight"][0],
            width=shapes["frontend.linear.weight"][0],
            inner=shapes[f"{blocks}0.1.net.1.weight"][0],
            layers=len({name.split(".")[2] for name in shapes if name.startswith(blocks)}),
            head=2 * shapes[f"{blocks}0.0.rotary_embed.freqs"][0],
            partial=any(".partial." in name for name in shapes),
            summed=summed,
        )

    @property
    def possible(self) -> bool:
        """Whether bands and heads have valid divisors."""
        widths = [self.width, *(self.stem * 2**k for k in range(_N_HALVINGS) if self.partial)]
        return self.bands % (4 * 2**_N_HALVINGS) == 0 and self.head > 0 and not any(w % self.head for w in widths)


class BeatNetwork(nn.Module):
    """Spectrum (T, bands) to logits (T, 2): beat, downbeat. Frames are 20 ms apart."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.sizes = sizes
        self.frontend = _Frontend(sizes)
        self.transformer_blocks = _Transformer(sizes)
        self.task_heads = nn.ModuleDict({"beat_downbeat_lin": nn.Linear(sizes.width, 2)})
        self.eval()

    def forward(self, spectrum: Tensor) -> Tensor:
        """Return the logits of one stretch of a song."""
        hidden = self.transformer_blocks(self.frontend(spectrum[None]))[0]
        logits: Tensor = self.task_heads["beat_downbeat_lin"](hidden)
        return torch.stack([logits.sum(1), logits[:, 1]], dim=1) if self.sizes.summed else logits


class _Frontend(nn.Module):
    """(1, T, bands) to (1, T, width): convolutions that leave four bands, with attention between them."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        convolution = nn.Conv2d(1, sizes.stem, (4, 3), stride=(4, 1), padding=(0, 1), bias=False)
        self.stem = nn.ModuleDict(
            {"bn1d": nn.BatchNorm1d(sizes.bands), "conv2d": convolution, "bn2d": nn.BatchNorm2d(sizes.stem)}
        )
        self.blocks = nn.ModuleList([_Halving(sizes.stem * 2**k, sizes) for k in range(_N_HALVINGS)])
        bands = sizes.bands // (4 * 2**_N_HALVINGS)
        self.linear = nn.Linear(sizes.stem * 2**_N_HALVINGS * bands, sizes.width)

    def forward(self, spectrum: Tensor) -> Tensor:
        bands = self.stem["bn1d"](spectrum.transpose(1, 2))[:, None]
        maps = functional.gelu(self.stem["bn2d"](self.stem["conv2d"](bands)))
        for block in self.blocks:
            maps = block(maps)
        tokens: Tensor = self.linear(maps.flatten(1, 2).transpose(1, 2))
        return tokens


class _Halving(nn.Module):
    """(1, C, F, T) to (1, 2 C, F / 2, T)."""

    def __init__(self, channels: int, sizes: Sizes) -> None:
        super().__init__()
        self.partial = _AcrossBandsAndTime(channels, sizes.head) if sizes.partial else nn.Identity()
        self.conv2d = nn.Conv2d(channels, 2 * channels, (2, 3), stride=(2, 1), padding=(0, 1), bias=False)
        self.norm = nn.BatchNorm2d(2 * channels)

    def forward(self, maps: Tensor) -> Tensor:
        activations: Tensor = functional.gelu(self.norm(self.conv2d(self.partial(maps))))
        return activations


class _AcrossBandsAndTime(nn.Module):
    """A transformer block in which the bands of a frame attend to each other, then one for the frames of a band."""

    def __init__(self, channels: int, head: int) -> None:
        super().__init__()
        inner = _FRONTEND_FACTOR * channels
        # The names are those of the checkpoints.
        self.attnF, self.ffF = _Attention(channels, head), _FeedForward(channels, inner)
        self.attnT, self.ffT = _Attention(channels, head), _FeedForward(channels, inner)

    def forward(self, maps: Tensor) -> Tensor:
        x: Tensor = maps[0].permute(2, 1, 0)  # (T, F, C)
        x = x + self.attnF(x)
        x = (x + self.ffF(x)).transpose(0, 1)  # (F, T, C)
        x = x + self.attnT(x)
        mixed: Tensor = (x + self.ffT(x)).permute(2, 0, 1)
        return mixed[None]


class _Transformer(nn.Module):
    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        width, head = sizes.width, sizes.head
        blocks = [_Residual(_Attention(width, head), _FeedForward(width, sizes.inner)) for _ in range(sizes.layers)]
        self.layers = nn.Sequential(*blocks)
        self.norm = _RootMeanSquareNorm(width)

    def forward(self, x: Tensor) -> Tensor:
        encoded: Tensor = self.norm(self.layers(x))
        return encoded


class _Residual(nn.Sequential):
    def forward(self, x: Tensor) -> Tensor:
        for part in self:
            change: Tensor = part(x)
            x = x + change
        return x


class _RootMeanSquareNorm(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(width))

    def forward(self, x: Tensor) -> Tensor:
        unit: Tensor = functional.normalize(x, dim=-1) * x.shape[-1] ** 0.5
        return unit * self.gamma


class _FeedForward(nn.Module):
    def __init__(self, width: int, inner: int) -> None:
        super().__init__()
        widen, narrow = nn.Linear(width, inner), nn.Linear(inner, width)
        # In training, place 3 has a dropout.
        self.net = nn.Sequential(_RootMeanSquareNorm(width), widen, nn.GELU(), nn.Identity(), narrow)

    def forward(self, x: Tensor) -> Tensor:
        values: Tensor = self.net(x)
        return values


class _Attention(nn.Module):
    """Attention (B, N, C) with rotary positions, of which each head has a gate."""

    def __init__(self, width: int, head: int) -> None:
        super().__init__()
        self.head = head
        self.norm = _RootMeanSquareNorm(width)
        self.to_qkv = nn.Linear(width, 3 * width, bias=False)
        self.to_gates = nn.Linear(width, width // head)
        self.to_out = nn.Sequential(nn.Linear(width, width, bias=False))
        self.rotary_embed = _Rotary(head)

    def forward(self, x: Tensor) -> Tensor:
        x = self.norm(x)
        split: Any = self.to_qkv(x).unflatten(-1, (3, -1, self.head)).permute(2, 0, 3, 1, 4)
        query, key, value = split  # (B, heads, N, head) each
        attended = functional.scaled_dot_product_attention(self.rotary_embed(query), self.rotary_embed(key), value)
        gated = attended * self.to_gates(x).sigmoid().transpose(1, 2)[..., None]
        mixed: Tensor = self.to_out(gated.transpose(1, 2).flatten(2))
        return mixed


class _Rotary(nn.Module):
    """Turns each pair of columns by an angle proportional to the position (Su et al. 2021, RoFormer)."""

    freqs: Tensor

    def __init__(self, head: int) -> None:
        super().__init__()
        self.register_buffer("freqs", 10000.0 ** (-torch.arange(0, head, 2) / head))

    def forward(self, x: Tensor) -> Tensor:
        angles = torch.arange(x.shape[-2], device=x.device, dtype=self.freqs.dtype)[:, None] * self.freqs
        even, odd = x[..., 0::2], x[..., 1::2]
        cos, sin = angles.cos(), angles.sin()
        return torch.stack([even * cos - odd * sin, odd * cos + even * sin], dim=-1).flatten(-2)

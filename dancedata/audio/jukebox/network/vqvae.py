"""The VQ-VAE's level-2 encoder: 128 samples become one of 2048 codes. Always fp32."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch.nn.functional import conv1d, relu

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.network.tensors import CODEBOOK, ENCODER
from dancedata.audio.networks.devices import exact_float32

# Codes at once whose distances to all code vectors are computed: 17 MB at 2048 code vectors.
_CHUNK = 1024


class VqEncoder:
    """Encoder and codebook.

    Parameters
    ----------
    config
        Sizes.
    weights
        The tensors of `names.vqvae_tensors` by name, on the device, in fp32.
    """

    def __init__(self, config: JukeboxConfig, weights: Mapping[str, torch.Tensor]) -> None:
        self.config = config
        self._weights = weights
        self._codebook = weights[CODEBOOK].double()
        self._squares = self._codebook.square().sum(1)

    def __call__(self, audio: torch.Tensor) -> torch.Tensor:
        """Encode clips of one length.

        Parameters
        ----------
        audio
            (B, n) float32 at the config's sample rate, n at least `hop`.

        Returns
        -------
        torch.Tensor
            (B, n // hop) int64.
        """
        x = audio[:, None]
        with exact_float32():
            for level, steps in enumerate(self.config.downs):
                prefix = f"{ENCODER}.{level}.model"
                for step in range(steps):
                    x = self._conv(x, f"{prefix}.{step}.0", stride=2, padding=1)
                    for unit in range(self.config.conv_depth):
                        self._add_residual(x, f"{prefix}.{step}.1.model.{unit}.model", unit)
                x = self._conv(x, f"{prefix}.{steps}", padding=1)
        return torch.stack([self._nearest(clip.T) for clip in x])

    def _add_residual(self, x: torch.Tensor, prefix: str, unit: int) -> None:
        """Add conv1(relu(conv3(relu(x)))) to x, in place."""
        dilation = self.config.dilation_growth**unit
        y = self._conv(relu(x), f"{prefix}.1", padding=dilation, dilation=dilation)
        x += self._conv(y.relu_(), f"{prefix}.3")

    def _conv(
        self, x: torch.Tensor, name: str, *, stride: int = 1, padding: int = 0, dilation: int = 1
    ) -> torch.Tensor:
        weight, bias = self._weights[f"{name}.weight"], self._weights[f"{name}.bias"]
        return conv1d(x, weight, bias, stride=stride, padding=padding, dilation=dilation)

    def _nearest(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return the nearest code vectors (T,) of (T, D) in Euclidean distance; of equal ones the first.

        In fp64: near-ties are decided the same way on all devices, and whatever the other clips.
        """
        chunks = torch.split(vectors.double(), _CHUNK)
        return torch.cat([(self._squares - 2 * chunk @ self._codebook.T).argmin(1) for chunk in chunks])

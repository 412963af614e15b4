"""The network of MuQ, written from its published description: log-mel, two convolutional modules, a conformer."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn
from transformers.audio_utils import mel_filter_bank
from transformers.models.wav2vec2_conformer.configuration_wav2vec2_conformer import Wav2Vec2ConformerConfig
from transformers.models.wav2vec2_conformer.modeling_wav2vec2_conformer import Wav2Vec2ConformerEncoder

from dancedata.audio.hf.families.muq import N_FFT, SAMPLE_RATE

_FLOOR = 1e-10


class Residual(nn.Module):
    """Two 3 x 3 convolutions, the first with a stride, in parallel to one with the same stride."""

    def __init__(self, channels_in: int, channels: int, stride: tuple[int, int]) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels_in, channels, 3, padding=1, stride=stride)
        self.bn1 = nn.BatchNorm2d(channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)
        self.bn2 = nn.BatchNorm2d(channels)
        self.conv3 = nn.Conv2d(channels_in, channels, 3, padding=1, stride=stride)
        self.bn3 = nn.BatchNorm2d(channels)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Compute fewer bins and frames of (B, C, bins, frames)."""
        inner = self.bn2(self.conv2(torch.relu(self.bn1(self.conv1(x)))))
        return torch.relu(self.bn3(self.conv3(x)) + inner)


class Subsampling(nn.Module):
    """A log-mel spectrogram to frames of the conformer's width."""

    def __init__(self, channels: int, width: int, strides: tuple[int, int], n_bins: int) -> None:
        super().__init__()
        first, second = strides
        self.conv = nn.Sequential(Residual(1, channels, (2, first)), Residual(channels, channels, (2, second)))
        self.linear = nn.Linear(channels * (n_bins // 4), width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Compute (B, K, width) of (B, bins, frames)."""
        tokens: torch.Tensor = self.linear(self.conv(x[:, None]).permute(0, 3, 1, 2).flatten(2))
        return tokens


class MuQNetwork(nn.Module):
    """MuQ's encoder; `strides` are those of the convolutional modules, in time."""

    def __init__(self, config: Mapping[str, Any], strides: tuple[int, int]) -> None:
        super().__init__()
        stat = config.get("stat") or {}
        self.mean, self.std = float(stat["melspec_2048_mean"]), float(stat["melspec_2048_std"])
        self.hop = int(config.get("hop_length", 240))
        n_bins, width = int(config.get("n_mels", 128)), int(config.get("encoder_dim", 1024))
        self.conv = Subsampling(int(config.get("conv_dim", 512)), width, strides, n_bins)
        inner = {k: v for k, v in (config.get("w2v2_config") or {}).items() if k != "model_type"}
        inner |= {"num_hidden_layers": int(config["encoder_depth"]), "hidden_size": width}
        conformer = Wav2Vec2ConformerConfig(**inner)
        conformer._attn_implementation = "eager"
        self.conformer = Wav2Vec2ConformerEncoder(conformer)
        filters = mel_filter_bank(
            num_frequency_bins=N_FFT // 2 + 1,
            num_mel_filters=n_bins,
            min_frequency=0.0,
            max_frequency=SAMPLE_RATE / 2,
            sampling_rate=SAMPLE_RATE,
            norm=None,
            mel_scale="htk",
        )
        self.filters: torch.Tensor
        self.window: torch.Tensor
        self.register_buffer("filters", torch.tensor(filters, dtype=torch.float32), persistent=False)
        self.register_buffer("window", torch.hann_window(N_FFT), persistent=False)

    def log_mel(self, samples: torch.Tensor) -> torch.Tensor:
        """Compute normalised decibels (B, bins, n // hop) of samples (B, n), in float32."""
        spectrum = torch.stft(
            samples.float(), N_FFT, self.hop, window=self.window.float(), center=True, pad_mode="reflect",
            return_complex=True,
        )  # fmt: skip
        power = spectrum.abs().square().transpose(1, 2) @ self.filters.float()
        decibels = 10 * torch.log10(power.clamp(min=_FLOOR))
        frames = decibels.transpose(1, 2)[..., : samples.shape[-1] // self.hop]
        return (frames - self.mean) / self.std

    def forward(self, samples: torch.Tensor) -> Any:
        """Compute the conformer's output of samples (B, n); its `last_hidden_state` is (B, K, width)."""
        return self.conformer(self.conv(self.log_mel(samples).to(self.conv.linear.weight.dtype)))

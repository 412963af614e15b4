"""wav2vec2 and what is built like it: convolutions over samples, then a transformer. MERT is one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from dancedata.audio.hf.families.base import (
    Family,
    NetworkSpec,
    Prepared,
    Samples,
    Timing,
    conv_field,
    conv_length,
    uniform,
    waveform,
)
from dancedata.core.errors import SourceError
from dancedata.core.text import quoted
from dancedata.core.typing import override

#: Heads and quantisers of training, which features do not need.
_HEADS = (
    r"(lm_head|classifier|projector|quantizer|project_hid|project_q|final_proj|label_embs_concat|adapter)\b.*",
    r"(.*\.)?masked_spec_embed",
)
#: Stems of class names by model type.
_STEMS = {
    "wav2vec2": "Wav2Vec2",
    "wav2vec2-conformer": "Wav2Vec2Conformer",
    "hubert": "Hubert",
    "wavlm": "WavLM",
    "data2vec-audio": "Data2VecAudio",
    "unispeech": "UniSpeech",
    "unispeech-sat": "UniSpeechSat",
    "mert_model": "Hubert",
}
#: Keys of MERT's published config that HuBERT has not, and the only value with which the two are the same network.
_MERT_OFF = ("feature_extractor_cqt", "deepnorm")


@dataclass(frozen=True)
class WaveformEncoder(Family):
    """wav2vec 2.0 (Baevski et al. 2020), HuBERT, WavLM, data2vec, UniSpeech; MERT (Li et al. 2024) as HuBERT."""

    name: ClassVar[str] = "wav2vec2-like"
    model_types: ClassVar[tuple[str, ...]] = tuple(_STEMS)

    @property
    @override
    def timing(self) -> Timing:
        field, hop = conv_field(self._kernels, self._strides)
        return uniform(self.sample_rate, hop, Fraction(field - 1, 2))

    @property
    @override
    def min_samples(self) -> int:
        return conv_field(self._kernels, self._strides)[0]

    @override
    def n_frames(self, n_samples: int) -> int:
        return conv_length(n_samples, self._kernels, self._strides)

    @override
    def prepared(self, samples: Samples, *, normalize: bool) -> Prepared:
        if normalize and self.extractor.get("do_normalize", True):
            samples = (samples - samples.mean()) / np.sqrt(samples.var() + np.float32(1e-7))
        return waveform(samples.astype(np.float32, copy=False))

    @override
    def network(self, top: int) -> NetworkSpec:
        kind = str(self.config["model_type"])
        # Masking belongs to training; without it the model has no vector for it.
        config = self.keys(num_hidden_layers=max(top, 1), mask_time_prob=0.0, mask_feature_prob=0.0)
        if kind == "mert_model":  # attention_relax is of deepnorm's branch only
            config = {k: v for k, v in config.items() if not k.startswith((*_MERT_OFF, "attention_relax"))}
        stem = _STEMS[kind]
        prefix = tuple(rf"(\w+\.)?{head}" for head in _HEADS)
        unexpected = (*prefix, *self.above(top, r"(\w+\.)?encoder\.layers"))
        return NetworkSpec(f"{stem}Model", (f"{stem}Config", config), unexpected=unexpected)

    def __post_init__(self) -> None:
        on = [key for key in _MERT_OFF if self.config.get(key)]
        if self.config.get("model_type") == "mert_model" and on:
            raise SourceError(
                "hf: this MERT differs from HuBERT, so transformers has no class for it",
                found=", ".join(f"{key}: {quoted(self.config[key])}" for key in on),
                allowed="MERT v0 and v1, whose configs have false there",
                fix="remote code is never run; another network needs a plug-in (docs/tutorials/add-your-own.md)",
            )
        if len(self._kernels) != len(self._strides) or math.prod(self._strides) < 1:
            raise SourceError("hf: conv_kernel and conv_stride of the config do not fit together")

    @property
    def _kernels(self) -> tuple[int, ...]:
        return self.sizes("conv_kernel", (10, 3, 3, 3, 3, 2, 2))

    @property
    def _strides(self) -> tuple[int, ...]:
        return self.sizes("conv_stride", (5, 2, 2, 2, 2, 2, 2))

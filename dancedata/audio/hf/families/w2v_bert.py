"""w2v-BERT 2.0: a conformer over pairs of log-mel frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.audio.hf.families.base import Family, NetworkSpec, Prepared, Samples, Timing, uniform
from dancedata.core.typing import override

_MEL_HOP, _MEL_FIELD = 160, 400
#: Kaldi's scale: 16-bit integers.
_FULL_SCALE = 1 << 15


@dataclass(frozen=True)
class W2vBert(Family):
    """w2v-BERT 2.0 (Chung et al. 2021; Seamless Communication 2023)."""

    name: ClassVar[str] = "w2v-bert"
    model_types: ClassVar[tuple[str, ...]] = ("wav2vec2-bert",)
    depth: ClassVar[tuple[str, int]] = ("num_hidden_layers", 24)
    size: ClassVar[tuple[str, int]] = ("hidden_size", 1024)

    @property
    def _stride(self) -> int:
        return self.number("stride", of=self.extractor, default=2)

    @property
    @override
    def timing(self) -> Timing:
        return uniform(self.sample_rate, self._stride * _MEL_HOP, self.min_samples // 2)

    @property
    @override
    def min_samples(self) -> int:
        return (self._stride - 1) * _MEL_HOP + _MEL_FIELD

    @override
    def n_frames(self, n_samples: int) -> int:
        return max(0, (n_samples - _MEL_FIELD) // _MEL_HOP + 1) // self._stride

    @override
    def prepared(self, samples: Samples, *, normalize: bool) -> Prepared:
        from dancedata.audio.hf.mel import kaldi_log_mel

        mel = kaldi_log_mel(
            samples * np.float32(_FULL_SCALE),
            self.sample_rate,
            n_bins=self.number("num_mel_bins", of=self.extractor, default=80),
            window="povey",
        )
        if normalize and len(mel) > 1:
            # Bins in one piece each, as in the extractor: numpy then adds in its order, and far more exactly.
            mel = np.asfortranarray(mel)
            mel = (mel - mel.mean(axis=0)) / np.sqrt(mel.var(axis=0, ddof=1) + np.float32(1e-7))
        pairs = np.ascontiguousarray(mel)

        def inputs(start: int, n_samples: int) -> npt.NDArray[np.float32]:
            first, n_frames = start // _MEL_HOP, self.n_frames(n_samples)
            return pairs[first : first + n_frames * self._stride].reshape(n_frames, -1)

        return inputs

    @override
    def network(self, top: int) -> NetworkSpec:
        config = self.keys(
            num_hidden_layers=max(top, 1),
            mask_time_prob=0.0,
            mask_feature_prob=0.0,
            add_adapter=False,
            use_intermediate_ffn_before_adapter=False,
        )
        heads = r"(\w+\.)?(lm_head|classifier|projector|adapter|intermediate_ffn|masked_spec_embed)\b.*"
        unexpected = (heads, *self.above(top, r"(\w+\.)?encoder\.layers"))
        return NetworkSpec("Wav2Vec2BertModel", ("Wav2Vec2BertConfig", config), unexpected=unexpected)

"""Configs of encoders by which a song would be cut into far more frames than in any model; needs no torch."""

import json
from pathlib import Path
from typing import Any

import pytest

from dancedata.audio.hf.model_folder import open_model
from dancedata.audio.hf.settings import settings_of
from dancedata.core.errors import SourceError
from tests.messages import raises_message

MERT = {"model_type": "mert_model", "sample_rate": 24_000, "num_hidden_layers": 2, "hidden_size": 24}
CLAP = {"model_type": "clap_audio_model"}


def settings(folder: Path, config: dict[str, Any], extractor: dict[str, Any]) -> Any:
    folder.mkdir(exist_ok=True)
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "preprocessor_config.json").write_text(json.dumps({"sampling_rate": 24_000, **extractor}))
    keys: dict[str, Any] = {"layers": "last", "reduce": "concat", "resample": "auto", "normalize": "extractor"}
    return settings_of(open_model(str(folder)), output="auto", chunk_s=None, overlap_s=None, **keys)


@pytest.mark.parametrize(
    ("config", "extractor", "found"),
    [
        ({"model_type": "whisper"}, {"sampling_rate": 16_000, "hop_length": 1}, "16,000 frames per second"),
        ({**MERT, "conv_stride": [1] * 7}, {}, "24,000 frames per second"),
        ({"model_type": "whisper", "max_source_positions": 1 << 20}, {"hop_length": 160}, "2,097,152 of them in a"),
        (CLAP, {"sampling_rate": 48_000, "hop_length": 1}, "48,000 frames per second"),
        (CLAP, {"sampling_rate": 48_000, "max_length_s": 10**6}, "of them in a window"),
        ({"model_type": "encodec", "upsampling_ratios": [1]}, {}, "24,000 frames per second"),
        ({"model_type": "muq", "hop_length": 1}, {}, "24,000 frames per second"),
    ],
)
def test_too_many_frames(tmp_path: Path, config: dict[str, Any], extractor: dict[str, Any], found: str) -> None:
    with raises_message(SourceError, "hop_length", where="model") as caught:
        settings(tmp_path / "model", config, extractor)
    assert found in str(caught.value)
    assert "at most 500 per second, and 30,000 in a window" in str(caught.value)


def test_published_rates_are_accepted(tmp_path: Path) -> None:
    for config, extractor, rate in (
        ({"model_type": "whisper"}, {"sampling_rate": 16_000}, 50),
        (MERT, {}, 75),
        (CLAP, {"sampling_rate": 48_000}, 3.2),
        ({"model_type": "encodec", "sampling_rate": 48_000}, {}, 150),
        ({"model_type": "audio-spectrogram-transformer"}, {"sampling_rate": 16_000}, 10),
    ):
        family = settings(tmp_path / "model", config, extractor).family
        assert float(family.timing.rate) == pytest.approx(rate, rel=0.01)

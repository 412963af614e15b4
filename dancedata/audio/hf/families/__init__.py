"""The families of encoders, by the model type that a config states."""

from collections.abc import Mapping
from typing import Any

from dancedata.audio.hf.families.base import MAX_BLOCKS, Family
from dancedata.audio.hf.families.codecs import Dac, Encodec, Mimi
from dancedata.audio.hf.families.muq import MuQ
from dancedata.audio.hf.families.pe_audio import PeAudio
from dancedata.audio.hf.families.spectrogram import Ast, Clap, Whisper
from dancedata.audio.hf.families.w2v_bert import W2vBert
from dancedata.audio.hf.families.waveform import WaveformEncoder
from dancedata.core.errors import SourceError, did_you_mean
from dancedata.core.text import quoted

FAMILIES: tuple[type[Family], ...] = (WaveformEncoder, W2vBert, Encodec, Dac, Mimi, Whisper, Ast, Clap, PeAudio, MuQ)
_BY_TYPE = {model_type: family for family in FAMILIES for model_type in family.model_types}
#: Keys of MuQ's config, which has no model_type.
_OF_MUQ = ("encoder_depth", "encoder_dim", "w2v2_config", "stat")
_PLUGIN = "a network of another kind needs a plug-in: docs/tutorials/add-your-own.md"


def family_of(config: Mapping[str, Any], extractor: Mapping[str, Any], where: object = None) -> Family:
    """Return the family of a model; SourceError if it is unknown, needs remote code, or its config cannot be used."""
    kind = config.get("model_type")
    if kind is None and all(key in config for key in _OF_MUQ):
        kind = "muq"
    if not isinstance(kind, str) or kind not in _BY_TYPE:
        suggestion = did_you_mean(str(kind), sorted(_BY_TYPE))
        remote = "auto_map" in config
        raise SourceError(
            "hf: the model needs its own code, which is never run"
            if remote
            else "hf: no encoder of this model type is supported",
            where=where,
            found=f"model_type {quoted(kind)}" + (", with an auto_map to code in the folder" if remote else ""),
            fix=f"{suggestion}; {_PLUGIN}",
        )
    if config.get("quantization_config"):
        raise SourceError(
            "hf: the weights are quantised", where=where, fix="use the model's original weights, which are not"
        )
    # Those that no family reads: transformers would build as many.
    for key, value in config.items():
        if key.endswith("_layers") and isinstance(value, int) and value > MAX_BLOCKS:
            raise SourceError(f"hf: the config of a {kind} model has no valid {key}", where=where,
                              found=quoted(value), allowed=f"at most {MAX_BLOCKS:,}")  # fmt: skip
    try:
        return _BY_TYPE[kind](config, extractor)
    except SourceError as error:
        error.where = error.where or where
        raise

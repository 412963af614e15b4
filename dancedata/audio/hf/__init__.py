"""Learned music features of any native Hugging Face encoder: exact time stamps, checked weights, no remote code."""

from dancedata.audio.hf.feature import HuggingFace

__all__ = ["HuggingFace"]

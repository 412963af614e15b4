"""Bailando's 438 columns of music, computed by librosa."""

from dancedata.audio.bailando438.feature import Bailando438

__all__ = ["Bailando438"]

"""Beats and downbeats of music as rows: by librosa, or by the network of Beat This!."""

from dancedata.audio.beats.feature import Beats

__all__ = ["Beats"]

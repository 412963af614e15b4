"""The 35 librosa columns of EDGE, Lodge, FineDance and FACT: a version that calls librosa, and a fast one."""

from dancedata.audio.librosa35.feature import Librosa35

__all__ = ["Librosa35"]

"""The 35 librosa columns of EDGE, Lodge, FineDance and FACT: by librosa, and the same numbers many times faster."""

from dancedata.audio.librosa35.feature import Librosa35

__all__ = ["Librosa35"]

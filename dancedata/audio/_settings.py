"""Sizes and settings of features that librosa computes."""

from dataclasses import dataclass

#: Samples per frame at the features' sample rate.
HOP = 512
N_COLUMNS = 35
#: The tempo is estimated from the audio as `librosa.load` gives it by default.
TEMPO_SAMPLE_RATE = 22050


@dataclass(frozen=True)
class Settings:
    """Parameters of the analysis of a signal; rates in Hz.

    `rate`: At which features are computed: `HOP` times the frame rate.
    `start_bpm`: Where the search for the tempo starts, in beats per minute; None: at an estimate from the signal.
    `tightness`: How closely beats keep to the tempo (librosa's `beat_track`).
    """

    sample_rate: int
    rate: int
    start_bpm: float | None
    tightness: float

"""The 438 columns of music that Bailando and Bailando++ read."""

from dataclasses import dataclass

from dancedata.audio._bailando import BailandoFeature
from dancedata.core.registry import FEATURES


@FEATURES.register("bailando438")
@dataclass(frozen=True)
class Bailando438(BailandoFeature):
    """MFCC 20, their derivative 20, chroma 12, onset envelope 1, beats 1, tempogram 384.

    Parameters
    ----------
    onset_fmax
        Upper limit of the mel bands whose median is the onset envelope. "era": 11,025 Hz, as in librosa 0.8, which
        Bailando's requirements pin. At 7.5 rows per second more than half of the bands are above half the sample
        rate and are empty: envelope, beats and tempogram are zero in every row, as in the published data.
        "nyquist": half the sample rate, as in librosa 0.10 and later.
    """

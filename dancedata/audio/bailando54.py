"""The 54 columns of music that Duolando reads (Siyao et al., ICLR 2024): Bailando's without the tempogram."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from dancedata.audio._bailando import GROUPS, BailandoFeature, Floats, first_columns
from dancedata.audio._settings import HOP
from dancedata.core.columns import Columns
from dancedata.core.registry import FEATURES
from dancedata.core.typing import override

#: Seven octaves from 32.7 Hz, and the width of the highest filter, lie below half of it.
_MIN_SAMPLE_RATE = 18 * HOP


@FEATURES.register("bailando54")
@dataclass(frozen=True)
class Bailando54(BailandoFeature):
    """MFCC 20, their derivative 20, chroma 12, onset envelope 1, beats 1; chroma of seven octaves at every rate.

    Parameters
    ----------
    onset_fmax
        As in `bailando438`. "nyquist", the default, is Duolando's script run with librosa 0.11.
    """

    onset_fmax: Literal["era", "nyquist"] = "nyquist"

    columns: ClassVar[Columns] = Columns(GROUPS[:-1], None)
    min_sample_rate: ClassVar[int] = _MIN_SAMPLE_RATE
    usual_rates: ClassVar[str] = "use 30 rows per second (Duolando)"

    @override
    def _rows(self, samples: Floats, rate: int, onset_fmax: float) -> Floats:
        return first_columns(samples, rate, onset_fmax, octaves=7)

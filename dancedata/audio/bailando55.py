"""The 55 columns of music that InfiniteDance's retrieval reads (ECCV 2026): Bailando's, of the tempogram one lag."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dancedata.audio._bailando import GROUPS, BailandoFeature, Floats, compute
from dancedata.core.columns import Columns, Group
from dancedata.core.registry import FEATURES
from dancedata.core.typing import override

_COLUMNS = 55


@FEATURES.register("bailando55")
@dataclass(frozen=True)
class Bailando55(BailandoFeature):
    """MFCC 20, their derivative 20, chroma 12, onset envelope 1, beats 1, tempogram at lag 0; chroma of five octaves.

    The tempogram is an autocorrelation, scaled by its largest value: at lag 0 it is 1, or 0 in silence.

    Parameters
    ----------
    onset_fmax
        As in `bailando438`. "nyquist", the default, is InfiniteDance's script run with librosa 0.11.
    """

    onset_fmax: Literal["era", "nyquist"] = "nyquist"

    columns: ClassVar[Columns] = Columns((*GROUPS[:-1], Group("tempogram", 1, "1")), None)
    usual_rates: ClassVar[str] = "use 30 rows per second (InfiniteDance)"

    @override
    def _rows(self, samples: Floats, rate: int, onset_fmax: float) -> Floats:
        return np.ascontiguousarray(compute(samples, rate, onset_fmax, octaves=5)[:, :_COLUMNS])

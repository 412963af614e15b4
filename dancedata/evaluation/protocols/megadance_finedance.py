"""MEGADance's evaluation on FineDance."""

from types import MappingProxyType

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic

_WINDOWS = Pieces(length=1024, stride=512, shorter=True, multiple=8)
_CLASSIFIER = "needs the weights of MEGADance's own classifier"


@PROTOCOLS.register("megadance-finedance")
class MegadanceFinedance(Protocol):
    """MEGADance on FineDance: windows of 1,024 frames at 30 per second, its own kinetic features."""

    version = 1
    citation = "Yang et al., MEGADance: Mixture-of-Experts Architecture for Genre-Aware 3D Dance Generation."
    source = "XulongT/MEGADance e145b8f, utils/metric.py"
    licence_note = "no licence in the repository; none of its code is used here."
    motion = MotionRule("smpl24", 30)
    truth = _WINDOWS
    generated = _WINDOWS
    measures = (
        Measure(Kinetic("megadance", statistics="torch")),
        Measure(Geometric(statistics="torch")),
        Measure(BeatAlignment("bailando", "music", 3, unit="frames", cut="frames", no_music_beats="zero")),
    )
    music = MusicRule(("librosa35",), 30)
    notes = (
        "the pool is the test windows only; standard deviations divide by M - 1",
        "clips of fewer than 1,024 frames are one window, cut to a multiple of 8",
        "beats are the program's: of motion half a frame (16.7 ms) early, of music a row (33.3 ms) late",
    )
    not_computable = MappingProxyType(
        {"genre_accuracy": _CLASSIFIER, "genre_fid": _CLASSIFIER, "genre_diversity": _CLASSIFIER}
    )

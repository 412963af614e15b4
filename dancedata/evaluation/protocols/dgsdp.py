"""DGSDP's evaluation: Bailando's programs on EDGE's data."""

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pfc


@PROTOCOLS.register("dgsdp")
class Dgsdp(Protocol):
    """DGSDP on EDGE's slices: 150 frames at 30 per second, z up, with y taken as up by the features."""

    version = 1
    citation = "DGSDP, mucunzhuzhu/DGSDP on GitHub; Siyao et al., Bailando, CVPR 2022, for the metrics."
    source = "mucunzhuzhu/DGSDP 479c0d5, eval"
    licence_note = "no licence in the repository; none of its code is used here."
    motion = MotionRule("smpl24", 30, "z")
    truth = Pieces(length=150, stride=15)
    generated = Pieces(first=1200, length=150, stride=15)
    measures = (
        Measure(Kinetic("code", up="y")),
        Measure(Geometric(up="y")),
        Measure(BeatAlignment("bailando", "music", 3, unit="frames", cut="steps")),
        Measure(Pfc("code", "z")),
    )
    music = MusicRule(
        ("librosa35",), 30, scope="window", about="the last of EDGE's 35 columns, computed for each slice by itself"
    )
    notes = (
        "features take the horizontal y axis as up, and 30 frames per second as 60 (slips of the code)",
        "beats of the music are those of each slice by itself: a dataset of window scope has them",
        "beats are the program's: of motion half a frame (16.7 ms) early, of music a row (33.3 ms) late",
    )

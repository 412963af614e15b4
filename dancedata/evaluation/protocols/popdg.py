"""POPDG's evaluation on PopDanceSet."""

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Protocol, Published
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pbc, Pfc


@PROTOCOLS.register("popdg")
class Popdg(Protocol):
    """POPDG: absolute positions at 30 frames per second, z up, FACT's beats, and PBC."""

    version = 1
    citation = "Luo et al., POPDG: Popular 3D Dance Generation with PopDanceSet, CVPR 2024."
    source = "Luke-Luo1/POPDG ec57d87, eval"
    licence_note = "MIT."
    motion = MotionRule("smpl24", 30, "z", pelvis="translation")
    measures = (
        Measure(Kinetic("code", "absolute", up="y")),
        Measure(Geometric("absolute", up="y")),
        Measure(
            BeatAlignment("fact", "motion", 3, unit="frames", cut="none", no_motion_beats="zero", clips=24), first=300
        ),
        Measure(Pfc("code", "z")),
        Measure(Pbc("code", "z")),
    )
    music = MusicRule(("librosa35",), 30, about="the last of EDGE's 35 columns; the original reads files of 150 rows")
    published = (
        Published(
            "ground truth", {"pfc": 1.5824, "pbc": 8.7365}, "POPDG, PopDanceSet", "PBC is printed as PFC by its code"
        ),
    )
    notes = (
        "BAS is the sum over clips divided by 24, whatever their number",
        "features take the horizontal y axis as up, and 30 frames per second as 60 (slips of the code)",
        "positions are absolute: raw PopDanceSet has to be moved by -5 m in y and +1 m in z of z-up axes, as POPDG "
        "does for training and for features",
        "more than 1,000 files are sampled at random by the original, without a seed; here all count",
        "beats are the program's: of motion half a frame (16.7 ms) late, of music a row (33.3 ms) late",
    )

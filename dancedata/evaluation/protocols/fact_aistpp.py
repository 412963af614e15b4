"""FACT's evaluation on AIST++."""

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol, Published
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic


@PROTOCOLS.register("fact-aistpp")
class FactAistpp(Protocol):
    """FACT on AIST++: absolute positions at 60 frames per second, beats from the motion to the music."""

    version = 1
    citation = "Li et al., AI Choreographer: Music Conditioned 3D Dance Generation with AIST++, ICCV 2021."
    source = "liruilong940607/mint d40065a, tools/calculate_fid_scores.py, calculate_beat_scores.py"
    licence_note = "Apache-2.0; the features are from fairmotion, BSD."
    motion = MotionRule("smpl24", 60, pelvis="body")
    generated = Pieces(skip=120)
    measures = (
        Measure(Kinetic("code", "absolute")),
        Measure(Geometric("absolute")),
        Measure(BeatAlignment("fact", "motion", 3, unit="frames", cut="frames", no_motion_beats="zero")),
    )
    music = MusicRule(("librosa35",), 60)
    published = (
        Published(
            "FACT",
            {"fid_k": 32, "fid_g": 17, "div_k": 6, "div_g": 6},
            "a comment in the code; upstream 38 and 27",
            "rounded in the comment",
        ),
    )
    notes = (
        "the energy columns hold the distance from the origin (a slip of the code), so FID_k depends on where the "
        "dancer stands",
        "FID_g of FACT's paper is from an older program with another bug, and cannot be reproduced",
        "the first 120 frames of generated motion are the seed and are not measured; pass them as the model does",
        "beats are the program's: of motion half a frame (8.3 ms) late, of music a row (16.7 ms) late",
    )

"""Motius' evaluation on AIST++."""

from types import MappingProxyType

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Protocol, Published
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.motius_physics import MotiusPhysics


@PROTOCOLS.register("motius-aistpp")
class MotiusAistpp(Protocol):
    """Motius on AIST++: Bailando's features at 60 frames per second from any rate, beats in seconds, and physics."""

    version = 1
    citation = "Motius, ZeyuLing/Motius on GitHub; Siyao et al., Bailando, CVPR 2022, for the features."
    source = "ZeyuLing/Motius 50cf750, motius/evaluation"
    licence_note = "no licence in the repository; none of its code is used here."
    motion = MotionRule("smpl24", None)
    measures = (
        Measure(Kinetic("code"), fps=60, first_generated=1200),
        Measure(Geometric(), fps=60, first_generated=1200),
        Measure(BeatAlignment("seconds", "music", 3 / 60, unit="s", no_motion_beats="zero", no_music_beats="zero")),
        Measure(MotiusPhysics()),
    )
    music = MusicRule(("bailando438",), 60, about="column 53 of Bailando's 438, at 60 per second")
    published = (
        Published(
            "ground truth",
            {"fid_k": 17.16, "fid_g": 10.66, "div_k": 8.17, "div_g": 7.49, "bas": 0.2247},
            "Motius' repository, a recomputation of Bailando's row",
            "40 clips against 1,320 motions",
            dataset="aist++",
            splits=("val", "test"),
        ),
    )
    notes = (
        "positions are interpolated linearly to 60 frames per second for the features",
        "the physical metrics are per frame: they compare at one frame rate only",
        "beats are the program's: of motion half a frame (16.7 ms at 30 FPS) early, of music a row (16.7 ms) late",
    )
    not_computable = MappingProxyType({"fid_utmr": "needs a trained encoder"})

"""GCD's evaluation of single dancers."""

from types import MappingProxyType

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic

_GROUPS = "a metric of groups; here dancers are measured one by one"


@PROTOCOLS.register("gcd")
class Gcd(Protocol):
    """GCD, each dancer alone: absolute positions at 30 frames per second, FACT's beats with another order."""

    version = 1
    citation = "Le et al., Controllable Group Choreography Using Contrastive Diffusion, SIGGRAPH Asia 2023."
    source = "aioz-ai/GCD b9524d8, eval/calculate_beat_scores.py, eval/features"
    licence_note = "MIT (code)."
    motion = MotionRule("smpl24", 30, pelvis="body")
    measures = (
        Measure(Kinetic("gcd-code", "absolute")),
        Measure(Geometric("absolute")),
        Measure(BeatAlignment("gcd", "motion", 2.12, unit="frames", cut="frames", no_motion_beats="zero")),
    )
    music = MusicRule(("librosa35",), 30)
    notes = ("beats are the program's: of motion half a frame (16.7 ms) late, of music a row (33.3 ms) late",)
    not_computable = MappingProxyType({"gmr": _GROUPS, "gmc": _GROUPS, "tif": _GROUPS})

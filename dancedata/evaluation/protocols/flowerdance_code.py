"""FlowerDance's evaluation, as its code has it."""

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pfc

_WINDOWS = Pieces(length=1024, stride=512, shorter=True)


@PROTOCOLS.register("flowerdance-code")
class FlowerdanceCode(Protocol):
    """FlowerDance: a horizontal axis as up, steps that wrap round at the first frame, and 22 joints."""

    version = 1
    citation = "FlowerDance, XulongT/FlowerDance on GitHub."
    source = "XulongT/FlowerDance 2352a1a, model/metric.py"
    licence_note = "no licence in the repository; none of its code is used here."
    motion = MotionRule("smpl24", 30, "z", turned=True)
    truth = _WINDOWS
    generated = _WINDOWS
    measures = (
        Measure(Kinetic("flowerdance-code", "absolute", joints=22, statistics="flowerdance")),
        Measure(Geometric("absolute", statistics="flowerdance")),
        Measure(BeatAlignment("bailando", "music", 3, unit="frames", cut="frames", no_music_beats="zero")),
        Measure(Pfc("code", "z")),
    )
    music = MusicRule(("librosa35",), 30)
    notes = (
        "V of the kinetic features is horizontal, and 30 frames per second count as 60 (slips of the code)",
        "the first step is from the last frame to the first, so clips that travel get a jump",
        "beats are the program's: of motion half a frame (16.7 ms) early, of music a row (33.3 ms) late",
    )

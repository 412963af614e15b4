"""Lodge's evaluation on FineDance."""

from types import MappingProxyType

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol, Published
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.foot_skating import FootSkating
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic

_FIRST = Pieces(first=1024)


@PROTOCOLS.register("lodge-finedance")
class LodgeFinedance(Protocol):
    """Lodge on FineDance: SMPL-X, 30 frames per second, the first 1,024 frames, positions relative to the root."""

    version = 1
    citation = "Li et al., Lodge: A Coarse to Fine Diffusion Network for Long Dance Generation, CVPR 2024."
    source = "li-ronghui/LODGE a898e59, metric"
    licence_note = "no licence in the repository; none of its code is used here."
    motion = MotionRule("smplx24", 30)
    truth = _FIRST
    generated = _FIRST
    measures = (
        Measure(Kinetic("code", "root_relative", joints=22)),
        Measure(Geometric("root_relative", joints=22)),
        Measure(BeatAlignment("bailando", "music", 3, unit="frames", cut="none")),
        Measure(FootSkating("lodge-code")),
    )
    music = MusicRule(
        ("librosa35",), 30, tempo=False,
        about="the original estimates the tempo as if the song had 22,050 samples per second",
    )  # fmt: skip
    published = (
        Published(
            "ground truth",
            {"skating": 0.0622, "div_k": 9.73, "div_g": 7.44, "bas": 0.2120},
            "Lodge, table 1",
            "the paper's text has 60 frames per second (LODGE#16), the released code 30 (LODGE#43)",
            dataset="finedance",
            splits=("test",),
        ),
    )
    notes = (
        "music is not cut to the motion: beats after its end are compared with its last beat",
        "the mean of the signed components of a step counts as its length: gliding along x = -z is not seen",
        "the original leaves out mirrored clips (M*) on both sides; so does this one",
        "beats are the program's: of motion half a frame (16.7 ms) early, of music a row (33.3 ms) late",
    )
    not_computable = MappingProxyType({"genre_matching_score": "needs the trained classifier of FineDance"})

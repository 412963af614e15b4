"""Protocols on FineDance, AIOZ-GDANCE and PopDanceSet."""

from types import MappingProxyType

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, PaperResult, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.foot_skating import FootSkating
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pbc, Pfc

_CLASSIFIER = "needs the weights of MEGADance's own classifier"
_GROUPS = "a metric of groups, which the protocol gcd-groups has; here dancers are measured one by one"


@PROTOCOLS.register("lodge-finedance")
class LodgeFinedance(Protocol):
    """Lodge on FineDance: SMPL-X, 30 frames per second, the first 1,024 frames, positions relative to the root."""

    version = 1
    citation = "Li et al., Lodge: A Coarse to Fine Diffusion Network for Long Dance Generation, CVPR 2024."
    source = "li-ronghui/LODGE a898e59, metric"
    licence_note = "no licence in the repository; none of its code is used here."
    pool_split = "all"
    motion = MotionRule("smplx24", 30)
    truth = generated = Pieces(first=1024)
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
        PaperResult(
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


@PROTOCOLS.register("megadance-finedance")
class MegadanceFinedance(Protocol):
    """MEGADance on FineDance: windows of 1,024 frames at 30 per second, its own kinetic features."""

    version = 1
    citation = "Yang et al., MEGADance: Mixture-of-Experts Architecture for Genre-Aware 3D Dance Generation."
    source = "XulongT/MEGADance e145b8f, utils/metric.py"
    licence_note = "no licence in the repository; none of its code is used here."
    motion = MotionRule("smpl24", 30)
    truth = generated = Pieces(length=1024, stride=512, shorter=True, multiple=8)
    pool_split = "test"
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


@PROTOCOLS.register("flowerdance-code")
class FlowerdanceCode(Protocol):
    """FlowerDance: a horizontal axis as up, steps that wrap round at the first frame, and 22 joints."""

    version = 1
    citation = "FlowerDance, XulongT/FlowerDance on GitHub."
    source = "XulongT/FlowerDance 2352a1a, model/metric.py"
    licence_note = "no licence in the repository; none of its code is used here."
    pool_split = "all"
    motion = MotionRule("smpl24", 30, "z", turned=True)
    truth = generated = Pieces(length=1024, stride=512, shorter=True)
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


@PROTOCOLS.register("gcd")
class Gcd(Protocol):
    """GCD, dancers one by one, not groups: absolute positions at 30 frames per second, FACT's beats reordered."""

    version = 1
    citation = "Le et al., Controllable Group Choreography Using Contrastive Diffusion, SIGGRAPH Asia 2023."
    source = "aioz-ai/GCD b9524d8, eval/calculate_beat_scores.py, eval/features"
    licence_note = "MIT (code)."
    pool_split = "all"
    motion = MotionRule("smpl24", 30, pelvis="body")
    measures = (
        Measure(Kinetic("gcd-code", "absolute")),
        Measure(Geometric("absolute")),
        Measure(BeatAlignment("gcd", "motion", 2.12, unit="frames", cut="frames", no_motion_beats="zero")),
    )
    music = MusicRule(("librosa35",), 30)
    notes = ("beats are the program's: of motion half a frame (16.7 ms) late, of music a row (33.3 ms) late",)
    not_computable = MappingProxyType({"gmr": _GROUPS, "gmc": _GROUPS, "tif": _GROUPS})


@PROTOCOLS.register("popdg")
class Popdg(Protocol):
    """POPDG: absolute positions at 30 frames per second, z up, FACT's beats, and PBC."""

    version = 1
    citation = "Luo et al., POPDG: Popular 3D Dance Generation with PopDanceSet, CVPR 2024."
    source = "Luke-Luo1/POPDG ec57d87, eval"
    licence_note = "MIT."
    pool_split = "all"
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
        PaperResult(
            "ground truth",
            {"pfc": 1.5824, "pbc": 8.7365},
            "POPDG, PopDanceSet",
            "PBC is printed as PFC by its code",
            dataset="popdanceset",
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

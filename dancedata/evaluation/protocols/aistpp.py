"""Protocols on AIST++."""

from types import MappingProxyType

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, PaperResult, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.motius_physics import MotiusPhysics
from dancedata.metrics.physical_contact import Pfc

_NOT_RELEASED = "EDGE's code for it was never released; dgsdp is the nearest open one"


@PROTOCOLS.register("fact-aistpp")
class FactAistpp(Protocol):
    """FACT on AIST++: absolute positions at 60 frames per second, beats from the motion to the music."""

    version = 1
    citation = "Li et al., AI Choreographer: Music Conditioned 3D Dance Generation with AIST++, ICCV 2021."
    source = "liruilong940607/mint d40065a, tools/calculate_fid_scores.py, calculate_beat_scores.py"
    licence_note = "Apache-2.0; the features are from fairmotion, BSD."
    pool_split = "all"
    motion = MotionRule("smpl24", 60, pelvis="body")
    generated = Pieces(skip=120)
    measures = (
        Measure(Kinetic("code", "absolute")),
        Measure(Geometric("absolute")),
        Measure(BeatAlignment("fact", "motion", 3, unit="frames", cut="frames", no_motion_beats="zero")),
    )
    music = MusicRule(("librosa35",), 60)
    published = (
        PaperResult(
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


@PROTOCOLS.register("bailando-aistpp")
class BailandoAistpp(Protocol):
    """Bailando on AIST++: positions from the first pelvis at 60 frames per second; from music to motion."""

    version = 1
    citation = "Siyao et al., Bailando: 3D Dance Generation by Actor-Critic GPT, CVPR 2022."
    source = "lisiyao21/Bailando cc90b98b, utils/metrics_new.py, utils/beat_align_score.py"
    licence_note = "S-Lab License 1.0, non-commercial; none of its code is used here."
    pool_split = "all"
    motion = MotionRule("smpl24", 60)
    generated = Pieces(first=1200)
    measures = (
        Measure(Kinetic("code")),
        Measure(Geometric()),
        Measure(BeatAlignment("bailando", "music", 3, unit="frames", cut="steps")),
    )
    music = MusicRule(
        ("bailando438",), 60, about="column 53 of Bailando's 438: beats of the percussive part of the song"
    )
    published = (
        PaperResult(
            "ground truth",
            {"fid_k": 17.10, "fid_g": 10.60, "div_k": 8.19, "div_g": 7.45, "bas": 0.2374},
            "Bailando, table 1",
            "40 clips of val and test against the pool; 0.2374 is not reached from released data, see motius-aistpp",
            dataset="aist++",
            splits=("val", "test"),
        ),
    )
    notes = (
        "predictions are cut to 1,200 frames, the pool is not",
        "the pool is every sequence except those on the ignore list",
        "the energy columns hold the distance from the first pelvis (a slip of the code)",
        "beats are the program's: of motion half a frame (8.3 ms) early, of music a row (16.7 ms) late",
    )


@PROTOCOLS.register("edge-aistpp")
class EdgeAistpp(Protocol):
    """EDGE on AIST++: PFC of pieces of five seconds at 30 frames per second, z up."""

    version = 1
    citation = "Tseng, Castellon, Liu, EDGE: Editable Dance Generation From Music, CVPR 2023."
    source = "Stanford-TML/EDGE 17c3428, eval/eval_pfc.py; the stride of 2.5 s is the paper's (EDGE#24)"
    licence_note = "MIT."
    pool_split = "all"
    motion = MotionRule("smpl24", 30, "z")
    truth = generated = Pieces(length=150, stride=75)
    measures = (Measure(Pfc("code", "z")),)
    published = (
        PaperResult(
            "ground truth",
            {"pfc": 1.332, "bas": 0.24, "div_k": 10.61, "div_g": 7.48},
            "EDGE, table 1",
            "only PFC has code; with other slices users get other values (EDGE#24)",
            dataset="aist++",
            splits=("test",),
        ),
    )
    notes = (
        "PFC depends on the length of the pieces: 1.33, 1.04 and 1.7 are published for 5, 7.5 and 10 s (PAMD)",
        "its mean has heavy tails: one jump of a tracker can double it, so read the median too",
    )
    not_computable = MappingProxyType({"bas": _NOT_RELEASED, "div_k": _NOT_RELEASED, "div_g": _NOT_RELEASED})


@PROTOCOLS.register("dgsdp")
class Dgsdp(Protocol):
    """DGSDP on EDGE's slices: 150 frames at 30 per second, z up, with y taken as up by the features."""

    version = 1
    citation = "DGSDP, mucunzhuzhu/DGSDP on GitHub; Siyao et al., Bailando, CVPR 2022, for the metrics."
    source = "mucunzhuzhu/DGSDP 479c0d5, eval"
    licence_note = "no licence in the repository; none of its code is used here."
    pool_split = "all"
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
        ("librosa35",), 30, by_piece=True, about="the last of EDGE's 35 columns, computed for each slice by itself"
    )
    notes = (
        "features take the horizontal y axis as up, and 30 frames per second as 60 (slips of the code)",
        "beats of the music are those of each slice by itself: a dataset of slices has them",
        "beats are the program's: of motion half a frame (16.7 ms) early, of music a row (33.3 ms) late",
    )


@PROTOCOLS.register("motius-aistpp")
class MotiusAistpp(Protocol):
    """Motius on AIST++: Bailando's features at 60 frames per second from any rate, beats in seconds, and physics."""

    version = 1
    citation = "Motius, ZeyuLing/Motius on GitHub; Siyao et al., Bailando, CVPR 2022, for the features."
    source = "ZeyuLing/Motius 50cf750, motius/evaluation"
    licence_note = "no licence in the repository; none of its code is used here."
    pool_split = "all"
    motion = MotionRule("smpl24", None)
    measures = (
        Measure(Kinetic("code"), fps=60, first_generated=1200),
        Measure(Geometric(), fps=60, first_generated=1200),
        Measure(BeatAlignment("seconds", "music", 3 / 60, unit="s", no_motion_beats="zero", no_music_beats="zero")),
        Measure(MotiusPhysics()),
    )
    music = MusicRule(("bailando438",), 60, about="column 53 of Bailando's 438, at 60 per second")
    published = (
        PaperResult(
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

"""Bailando's evaluation on AIST++."""

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol, Published
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic


@PROTOCOLS.register("bailando-aistpp")
class BailandoAistpp(Protocol):
    """Bailando on AIST++: positions from the first pelvis at 60 frames per second; from music to motion."""

    version = 1
    citation = "Siyao et al., Bailando: 3D Dance Generation by Actor-Critic GPT, CVPR 2022."
    source = "lisiyao21/Bailando cc90b98b, utils/metrics_new.py, utils/beat_align_score.py"
    licence_note = "S-Lab License 1.0, non-commercial; none of its code is used here."
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
        Published(
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

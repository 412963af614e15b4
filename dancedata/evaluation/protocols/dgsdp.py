"""DGSDP's evaluation: Bailando's programs on EDGE's data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pfc


@PROTOCOLS.register("dgsdp")
@dataclass(frozen=True)
class Dgsdp(Protocol):
    """DGSDP on EDGE's slices: 150 frames at 30 per second, z up, with y taken as up by the features."""

    version: ClassVar[int] = 1
    citation: ClassVar[str] = (
        "DGSDP, mucunzhuzhu/DGSDP on GitHub; Siyao et al., Bailando, CVPR 2022, for the metrics."
    )
    source: ClassVar[str] = "mucunzhuzhu/DGSDP 479c0d5, eval"
    licence_note: ClassVar[str] = "no licence in the repository; none of its code is used here."
    motion: ClassVar[MotionRule] = MotionRule("smpl24", 30, "z")
    truth: ClassVar[Pieces] = Pieces(length=150, stride=15)
    generated: ClassVar[Pieces] = Pieces(first=1200, length=150, stride=15)
    measures: ClassVar[tuple[Measure, ...]] = (
        Measure(Kinetic("code", up="y")),
        Measure(Geometric(up="y")),
        Measure(BeatAlignment("bailando", "music", 3, unit="frames", cut="steps")),
        Measure(Pfc("code", "z")),
    )
    music: ClassVar[MusicRule] = MusicRule(
        ("librosa35",), 30, scope="window", about="the last of EDGE's 35 columns, computed for each slice by itself"
    )
    notes: ClassVar[tuple[str, ...]] = (
        "features take the horizontal y axis as up, and 30 frames per second as 60 (slips of the code)",
        "beats of the music are those of each slice by itself: a dataset of window scope has them",
        "beats are the program's: of motion half a frame (16.7 ms) early, of music a row (33.3 ms) late",
    )

"""Motius' evaluation on AIST++."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Protocol, Published
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.motius_physics import MotiusPhysics


@PROTOCOLS.register("motius-aistpp")
@dataclass(frozen=True)
class MotiusAistpp(Protocol):
    """Motius on AIST++: Bailando's features at 60 frames per second from any rate, beats in seconds, and physics."""

    version: ClassVar[int] = 1
    citation: ClassVar[str] = (
        "Motius, ZeyuLing/Motius on GitHub; Siyao et al., Bailando, CVPR 2022, for the features."
    )
    source: ClassVar[str] = "ZeyuLing/Motius 50cf750, motius/evaluation"
    licence_note: ClassVar[str] = "no licence in the repository; none of its code is used here."
    motion: ClassVar[MotionRule] = MotionRule("smpl24", None)
    measures: ClassVar[tuple[Measure, ...]] = (
        Measure(Kinetic("code"), fps=60, first_generated=1200),
        Measure(Geometric(), fps=60, first_generated=1200),
        Measure(
            BeatAlignment("seconds", "music", 3 / 60, unit="s", no_motion_beats="zero", no_music_beats="zero"),
        ),
        Measure(MotiusPhysics()),
    )
    music: ClassVar[MusicRule] = MusicRule(
        ("bailando438",), 60, about="column 53 of Bailando's 438, at 60 per second"
    )
    published: ClassVar[tuple[Published, ...]] = (
        Published(
            "ground truth",
            {"fid_k": 17.16, "fid_g": 10.66, "div_k": 8.17, "div_g": 7.49, "bas": 0.2247},
            "Motius' repository, a recomputation of Bailando's row",
            "40 clips against 1,320 motions",
            dataset="aist++",
            splits=("val", "test"),
        ),
    )
    notes: ClassVar[tuple[str, ...]] = (
        "positions are interpolated linearly to 60 frames per second for the features",
        "the physical metrics are per frame: they compare at one frame rate only",
        "beats are the program's: of motion half a frame (16.7 ms at 30 FPS) early, of music a row (16.7 ms) late",
    )
    not_computable: ClassVar[Mapping[str, str]] = MappingProxyType({"fid_utmr": "needs a trained encoder"})

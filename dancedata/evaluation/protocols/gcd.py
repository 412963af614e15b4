"""GCD's evaluation of single dancers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic

_GROUPS = "a metric of groups; here dancers are measured one by one"


@PROTOCOLS.register("gcd")
@dataclass(frozen=True)
class Gcd(Protocol):
    """GCD, each dancer alone: absolute positions at 30 frames per second, FACT's beats with another order."""

    version: ClassVar[int] = 1
    citation: ClassVar[str] = (
        "Le et al., Controllable Group Choreography Using Contrastive Diffusion, SIGGRAPH Asia 2023."
    )
    source: ClassVar[str] = "aioz-ai/GCD b9524d8, eval/calculate_beat_scores.py, eval/features"
    licence_note: ClassVar[str] = "MIT (code)."
    motion: ClassVar[MotionRule] = MotionRule("smpl24", 30, pelvis="body")
    measures: ClassVar[tuple[Measure, ...]] = (
        Measure(Kinetic("gcd-code", "absolute")),
        Measure(Geometric("absolute")),
        Measure(
            BeatAlignment("gcd", "motion", 2.12, unit="frames", cut="frames", no_motion_beats="zero"),
        ),
    )
    music: ClassVar[MusicRule] = MusicRule(("librosa35",), 30)
    notes: ClassVar[tuple[str, ...]] = (
        "beats are the program's: of motion half a frame (16.7 ms) late, of music a row (33.3 ms) late",
    )
    not_computable: ClassVar[Mapping[str, str]] = MappingProxyType({"gmr": _GROUPS, "gmc": _GROUPS, "tif": _GROUPS})

"""MEGADance's evaluation on FineDance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic

_WINDOWS = Pieces(length=1024, stride=512, shorter=True, multiple=8)
_CLASSIFIER = "needs the weights of MEGADance's own classifier"


@PROTOCOLS.register("megadance-finedance")
@dataclass(frozen=True)
class MegadanceFinedance(Protocol):
    """MEGADance on FineDance: windows of 1,024 frames at 30 per second, its own kinetic features."""

    version: ClassVar[int] = 1
    citation: ClassVar[str] = (
        "Yang et al., MEGADance: Mixture-of-Experts Architecture for Genre-Aware 3D Dance Generation."
    )
    source: ClassVar[str] = "XulongT/MEGADance e145b8f, utils/metric.py"
    licence_note: ClassVar[str] = "no licence in the repository; none of its code is used here."
    motion: ClassVar[MotionRule] = MotionRule("smpl24", 30)
    truth: ClassVar[Pieces] = _WINDOWS
    generated: ClassVar[Pieces] = _WINDOWS
    measures: ClassVar[tuple[Measure, ...]] = (
        Measure(Kinetic("megadance", statistics="torch")),
        Measure(Geometric(statistics="torch")),
        Measure(BeatAlignment("bailando", "music", 3, unit="frames", cut="frames", no_music_beats="zero")),
    )
    music: ClassVar[MusicRule] = MusicRule(("librosa35",), 30)
    notes: ClassVar[tuple[str, ...]] = (
        "the pool is the test windows only; standard deviations divide by M - 1",
        "clips of fewer than 1,024 frames are one window, cut to a multiple of 8",
        "beats are the program's: of motion half a frame (16.7 ms) early, of music a row (33.3 ms) late",
    )
    not_computable: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"genre_accuracy": _CLASSIFIER, "genre_fid": _CLASSIFIER, "genre_diversity": _CLASSIFIER}
    )

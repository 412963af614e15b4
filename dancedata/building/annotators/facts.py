"""Computed events: turns, jumps, travel, contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal

from dancedata.building.plugins import ANNOTATORS, Annotator
from dancedata.building.take import Scene, Take
from dancedata.core.segments import Segment
from dancedata.metrics.events import KINDS, events
from dancedata.recipes.segments import VERSION, FactsSpec


@ANNOTATORS.register("facts")
@dataclass(frozen=True)
class Facts(Annotator):
    """Finds events of all dancers together, so that contacts are found.

    Attributes
    ----------
    kinds
        Some of turns, jumps, travel, energy, floor_work, contacts.
    turn_degrees, flight_s, travel_m
        Least turn, time in the air, and distance.
    """

    version: ClassVar[int] = VERSION
    copies: ClassVar[Literal["own", "parent", "none"]] = "own"

    kinds: tuple[str, ...] = KINDS
    turn_degrees: float = 150.0
    flight_s: float = 0.15
    travel_m: float = 1.0

    def annotate(self, scene: Scene) -> list[list[Any]]:
        """Return events of each dancer: label, frames, number, text, member, joint, data, and the rate of frames."""
        motion, joints = scene.motions[0], [m.joints() for m in scene.motions]
        document = self._spec.document()
        of_dancers = events(joints, float(motion.grid.rate), motion.skeleton, self.kinds, document)
        return [
            [[e.label, e.start, e.end, e.value, e.text, e.other, e.joint, dict(e.data), str(motion.grid)] for e in of]
            for of in of_dancers
        ]

    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        """Return the events of a dancer as segments, which name the partner's clip."""
        layer = self._spec.layer
        segments = []
        for label, start, end, value, text, other, joint, data, rate in rows:
            first, last = (Fraction(frame) / Fraction(rate) for frame in (start, end))
            partner = take.dancers[other].id if other >= 0 else ""
            segments.append(
                Segment(layer, first, last, label, (text,), value=value, other=partner, joint=joint, data=data)
            )
        return segments

    @property
    def _spec(self) -> FactsSpec:
        return FactsSpec(self.kinds, self.turn_degrees, self.flight_s, self.travel_m)

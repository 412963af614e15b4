"""Computed events: turns, jumps, travel, contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal

from dancedata.core.errors import UsageError
from dancedata.core.hashing import canonical_json
from dancedata.core.registry import ANNOTATORS
from dancedata.core.segments import Layer, Segment
from dancedata.core.text import shown
from dancedata.core.typing import override
from dancedata.files.documents import document_of
from dancedata.kernel import Annotator, Scene, Take
from dancedata.metrics.events import KINDS, MIRROR, UNITS, events

Kind = Literal["turns", "jumps", "travel", "energy", "floor_work", "contacts"]


@ANNOTATORS.register("facts")
@dataclass(frozen=True)
class Facts(Annotator):
    """Computes events from the motion, without a model: the layer `facts`; of all dancers of a group together.

    Attributes
    ----------
    kinds
        Some of turns, jumps, travel, energy, floor_work, contacts.
    turn_degrees
        Least turn.
    flight_s
        Least time in the air, seconds.
    travel_m
        Least distance, metres.
    """

    copies: ClassVar[Literal["own", "parent", "none"]] = "own"

    kinds: tuple[Kind, ...] = KINDS  # type: ignore[assignment]
    turn_degrees: float = 150.0
    flight_s: float = 0.15
    travel_m: float = 1.0

    def __post_init__(self) -> None:
        if not self.kinds or not set(self.kinds) <= set(KINDS):
            raise UsageError("kinds: unknown kind", found=shown(repr(self.kinds)), allowed=", ".join(KINDS))
        object.__setattr__(self, "kinds", tuple(kind for kind in KINDS if kind in self.kinds))
        for name in ("turn_degrees", "flight_s", "travel_m"):
            if not 0 < getattr(self, name) < 1e6:
                raise UsageError(f"{name}: must be a number above 0", found=shown(repr(getattr(self, name))))
            object.__setattr__(self, name, float(getattr(self, name)))

    @property
    def layer(self) -> Layer:
        """The layer of the events."""
        by = f"{self.name} {self.version} {canonical_json(document_of(self))}"
        return Layer(
            "facts", language="en", by=by, units=tuple(sorted(UNITS.items())), mirror=MIRROR, sided="mirrored"
        )

    @override
    def annotate(self, scene: Scene) -> list[list[Any]]:
        motion, joints = scene.motions[0], [m.joints() for m in scene.motions]
        of_dancers = events(joints, float(motion.grid.rate), motion.skeleton, self.kinds, document_of(self))
        return [
            [[e.label, e.start, e.end, e.value, e.text, e.other, e.joint, dict(e.data), str(motion.grid)] for e in of]
            for of in of_dancers
        ]

    @override
    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        layer, segments = self.layer, []
        for label, start, end, value, text, other, joint, data, rate in rows:
            first, last = (Fraction(frame) / Fraction(rate) for frame in (start, end))
            partner = take.dancers[other].id if other >= 0 else ""
            segments.append(
                Segment(layer, first, last, label, (text,), value=value, other=partner, joint=joint, data=data)
            )
        return segments

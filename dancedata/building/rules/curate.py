"""Windows and clips with faults are left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar, Literal

from dancedata.building.plugins import RULES, Seen, WindowRule
from dancedata.core.clip import Reject
from dancedata.core.segments import Segment


@RULES.register("curate")
@dataclass(frozen=True)
class Curate(WindowRule):
    """Leaves out windows that touch a segment of a label above a limit; or dancers whose score is above it.

    Attributes
    ----------
    label, limit
        Of the segments of any annotator.
    leave_out
        "windows", or the whole "clip".
    splits
        Splits that are judged; () for all.
    """

    version: ClassVar[int] = 1

    label: str
    limit: float
    leave_out: Literal["windows", "clip"] = "windows"
    splits: tuple[str, ...] = ()

    def judge(self, seen: Seen, dancer: int, starts: Sequence[int]) -> list[Reject]:
        """Return rejects of the windows that touch a span above the limit, or of the dancer."""
        if self.splits and seen.result.take.split not in self.splits:
            return []
        above = [s for s in seen.segments[dancer] if s.label == self.label and s.value > self.limit]
        of_clip = [s for s in above if s.data.get("of") == "clip"]
        spans = [s for s in above if s.data.get("of") != "clip"]
        if self.leave_out == "clip":
            all_spans = [s for s in seen.segments[dancer] if s.label == self.label and s.data.get("of") != "clip"]
            worst = max(all_spans, key=lambda s: s.value, default=None)
            file = str(seen.result.take.dancers[dancer].ref.motion_path)
            return [self._reject(s, worst, None, file) for s in of_clip[:1]]
        touched = {start: [s for s in spans if _touches(seen, start, s)] for start in starts}
        worst_of = {start: max(of, key=lambda s: s.value) for start, of in touched.items() if of}
        return [self._reject(s, s, start) for start, s in worst_of.items()]

    def _reject(self, segment: Segment, at: Segment | None, start: int | None, file: str = "") -> Reject:
        what, unit = segment.data.get("what", ""), segment.data.get("unit", "1")
        unit = "" if unit == "1" else f" {unit}"
        detail = f"{self.label}{f' ({what})' if what else ''}: {segment.value:.4g}{unit} is above the limit of "
        detail += f"{self.limit:g}{unit}"
        if at is not None:
            joint = f"{at.data['joint']}, " if at.data.get("joint") else ""
            detail += f" ({joint}{float(at.start):.2f} s to {float(at.end):.2f} s)"
        return Reject("curated", "", file, start, detail, {self.label: segment.value, "limit": self.limit})


def _touches(seen: Seen, start: int, segment: Segment) -> bool:
    """Whether a window covers an instant of a segment, or has a row that is interpolated from one of its frames.

    Rows between two frames are made of both, at the rate of each field.
    """
    stop = seen.grid.seconds(start + seen.length)
    rates = [f.grid.rate for f in seen.fields if f.kind != "audio" and not f.from_files]
    last = stop - 1 / max([seen.grid.rate, *rates])
    period = segment.data.get("period", Fraction(0))
    return bool(seen.grid.seconds(start) < segment.end and segment.start < max(stop, last + period))

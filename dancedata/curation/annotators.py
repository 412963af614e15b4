"""Scores of faults in motion, as spans: what `curate` judges windows by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

from dancedata.core.registry import ANNOTATORS
from dancedata.core.segments import CLIP_END, Layer, Segment
from dancedata.core.typing import override
from dancedata.curation.scores import VERSION, score_motion
from dancedata.kernel import Annotator, Scene, Take

LAYER = Layer("faults", by=f"curation {VERSION}", sided="no")


@ANNOTATORS.register("faults")
@dataclass(frozen=True)
class Faults(Annotator):
    """Finds faults of the motion: spans of each score, and its value over the whole clip, for rules; not stored.

    `Segment.data` has `of`, "spans" or "clip", the joint, and of spans `period`, the seconds between two frames, as
    rows between two frames are made of both.
    """

    version: ClassVar[int] = VERSION
    stored: ClassVar[bool] = False

    @override
    def annotate(self, scene: Scene) -> list[list[Any]]:
        return [
            [[name, score.value, [list(span) for span in score.spans], str(m.grid)] for name, score in scores.items()]
            for m in scene.motions
            for scores in [score_motion(m)]
        ]

    @override
    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        segments = []
        for name, value, spans, rate in rows:
            period = 1 / Fraction(rate)
            if value is not None:
                data: dict[str, Any] = {"of": "clip", "joint": ""}
                segments.append(Segment(LAYER, Fraction(0), CLIP_END, name, value=value, data=data))
            for start, end, of_span, joint in spans:
                data = {"of": "spans", "joint": joint, "period": period}
                segments.append(Segment(LAYER, start * period, end * period, name, value=of_span, data=data))
        return segments

"""Scores of faults in motion, as spans: what `curate` judges windows by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

from dancedata.building.plugins import ANNOTATORS, Annotator
from dancedata.building.take import Scene, Take
from dancedata.core.segments import CLIP_END, Layer, Segment
from dancedata.curation.scores import MEASURES, VERSION, score_motion

LAYER = Layer("faults", by=f"curation {VERSION}", sided="no")


@ANNOTATORS.register("faults")
@dataclass(frozen=True)
class Faults(Annotator):
    """Scores the motion of each dancer: a segment for each span of a score, and one of the clip with the score.

    `Segment.data` has what is measured, and of spans the seconds between two frames, `period`: rows between two
    frames are made of both.
    """

    version: ClassVar[int] = VERSION
    stored: ClassVar[bool] = False

    def annotate(self, scene: Scene) -> list[list[Any]]:
        """Return the scores of each dancer: name, value, spans, and the rate of their frames."""
        return [
            [[name, score.value, [list(span) for span in score.spans], str(m.grid)] for name, score in scores.items()]
            for m in scene.motions
            for scores in [score_motion(m)]
        ]

    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        """Return the scores of a dancer as segments."""
        segments = []
        for name, value, spans, rate in rows:
            period, measure = 1 / Fraction(rate), MEASURES[name]
            about = {"what": measure.what, "unit": measure.unit}
            if value is not None:
                of_clip = {**about, "of": "clip"}
                segments.append(Segment(LAYER, Fraction(0), CLIP_END, name, value=value, data=of_clip))
            for start, end, of_span, joint in spans:
                data = {**about, "period": period, "joint": joint}
                segments.append(Segment(LAYER, start * period, end * period, name, value=of_span, data=data))
        return segments

"""template_name: marks the times in which hands are above the head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal

import numpy as np

from dancedata.building.plugins import Annotator
from dancedata.building.take import Scene, Take
from dancedata.core.registry import ANNOTATORS
from dancedata.core.segments import Layer, Segment


@ANNOTATORS.register("template_name")
@dataclass(frozen=True)
class TemplateName(Annotator):
    """Marks spans in which the highest joint is an arm's: the layer `template_name`.

    Attributes
    ----------
    above_m
        How far above the head, metres.
    """

    version: ClassVar[int] = 1  # raise it whenever the same motion gives other spans
    copies: ClassVar[Literal["own", "parent", "none"]] = "own"  # of copies that move: found in their own motion

    above_m: float = 0.0

    def annotate(self, scene: Scene) -> list[list[Any]]:
        """Return JSON rows of each dancer: first frame, frame behind the last, metres, and the rate of frames."""
        of_dancers = []
        for motion in scene.motions:
            names, heights = motion.skeleton.joints, motion.joints()[..., 1]
            arms = [k for k, name in enumerate(names) if "wrist" in name or "hand" in name]
            others = [k for k in range(len(names)) if k not in arms]
            above = heights[:, arms].max(axis=1, initial=-np.inf) - heights[:, others].max(axis=1)
            edges = np.flatnonzero(np.diff(np.concatenate([[0], above > self.above_m, [0]]).astype(int))).tolist()
            spans = zip(edges[::2], edges[1::2], strict=True)
            of_dancers.append([[a, b, float(above[a:b].max()), str(motion.grid)] for a, b in spans])
        return of_dancers

    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        """Return the segments of a dancer, in seconds."""
        layer = Layer("template_name", by=f"template_name {self.version}", sided="no", units=(("hands up", "m"),))
        return [
            Segment(layer, a / Fraction(rate), b / Fraction(rate), "hands up", value=round(metres, 4))
            for a, b, metres, rate in rows
        ]

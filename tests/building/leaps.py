"""A capability in one file: motion is smoothed, leaps are marked and measured, windows with long ones left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.building.fields.motion import SceneField
from dancedata.building.plugins import Annotator, Seen, WindowRule
from dancedata.building.take import Scene, Take, Transform
from dancedata.core.clip import Reject
from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.motion import Motion
from dancedata.core.registry import ANNOTATORS, FIELDS, RULES, TRANSFORMS
from dancedata.core.segments import Layer, Segment


@TRANSFORMS.register("moving-average")
@dataclass(frozen=True)
class MovingAverage(Transform):
    """The place of the root, averaged over frames.

    Attributes
    ----------
    frames
        Their number, odd.
    """

    version: ClassVar[int] = 1
    frames: int = 5

    def scene(self, scene: Scene) -> Scene:
        pad = self.frames // 2
        smoothed = []
        for motion in scene.motions:
            padded = np.pad(motion.translation, ((pad, pad), (0, 0)), mode="edge")
            windows = np.lib.stride_tricks.sliding_window_view(padded, self.frames, axis=0)
            smoothed.append(replace(motion, translation=windows.mean(axis=2)))
        return scene.with_motions(smoothed)


@FIELDS.register("apart")
@dataclass(frozen=True)
class Apart(SceneField):
    """Distance of a dancer from the middle of all."""

    version: ClassVar[int] = 1

    @property
    def columns(self) -> Columns:
        return Columns((Group("distance", 1, "m"),), mirror=Mirror((0,), (1,)))

    def encode(self, motions: Sequence[Motion]) -> Sequence[npt.NDArray[np.float32]]:
        places = np.stack([motion.translation for motion in motions])
        return list(np.linalg.norm(places - places.mean(axis=0), axis=-1).astype(np.float32)[..., None])


@ANNOTATORS.register("leaps")
@dataclass(frozen=True)
class Leaps(Annotator):
    """Spans in which both feet are above a height.

    Attributes
    ----------
    above_m
        The height, metres.
    """

    version: ClassVar[int] = 1
    copies: ClassVar[Literal["own", "parent", "none"]] = "own"
    above_m: float = 0.03

    def annotate(self, scene: Scene) -> list[list[Any]]:
        of_dancers = []
        for motion in scene.motions:
            toes = motion.joints()[:, list(motion.skeleton.feet[2:]), 1]
            up = (toes - np.percentile(toes, 5)).min(axis=1) > self.above_m
            edges = np.flatnonzero(np.diff(np.concatenate([[0], up, [0]]).astype(int))).tolist()
            of_dancers.append([[a, b, str(motion.grid)] for a, b in zip(edges[::2], edges[1::2], strict=True)])
        return of_dancers

    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        layer = Layer("leaps", by=f"leaps {self.above_m}", sided="no", units=(("leap", "s"),))
        spans = [(a / Fraction(rate), b / Fraction(rate)) for a, b, rate in rows]
        return [Segment(layer, a, b, "leap", value=round(float(b - a), 4)) for a, b in spans]


@RULES.register("long-leaps")
@dataclass(frozen=True)
class LongLeaps(WindowRule):
    """Leaves out windows that touch a leap longer than a limit.

    Attributes
    ----------
    most_s
        The limit, seconds.
    """

    version: ClassVar[int] = 1
    most_s: float = 0.3

    def judge(self, seen: Seen, dancer: int, starts: Sequence[int]) -> list[Reject]:
        long = [s for s in seen.segments[dancer] if s.label == "leap" and s.value > self.most_s]
        spans = {start: (seen.grid.seconds(start), seen.grid.seconds(start + seen.length)) for start in starts}
        touched = [k for k, (first, end) in spans.items() if any(s.start < end and s.end > first for s in long)]
        return [Reject("filtered", window=k, detail=f"a leap of more than {self.most_s:g} s") for k in touched]

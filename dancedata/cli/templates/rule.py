"""template_name: leaves out windows that touch segments of a layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from dancedata.building.plugins import Seen, WindowRule
from dancedata.core.clip import Reject
from dancedata.core.registry import RULES


@RULES.register("template_name")
@dataclass(frozen=True)
class TemplateName(WindowRule):
    """Leaves out windows that touch a segment of a layer.

    Attributes
    ----------
    layer
        Name of the layer, one of the source or of an annotator that the recipe names.
    label
        Label of the segments; "" for all.
    """

    version: ClassVar[int] = 1  # raise it whenever different windows are kept

    layer: str = "unsure"
    label: str = ""

    def judge(self, seen: Seen, dancer: int, starts: Sequence[int]) -> list[Reject]:
        """Return a reject for each window of a dancer that is left out, by its first frame."""
        marked = [s for s in seen.segments[dancer] if s.layer.name == self.layer and self.label in ("", s.label)]
        rejects = []
        for start in starts:
            first, end = seen.grid.seconds(start), seen.grid.seconds(start + seen.length)
            touched = next((s for s in marked if s.start < end and s.end > first), None)
            if touched is not None:
                at = f"{float(touched.start):.2f} s to {float(touched.end):.2f} s"
                rejects.append(Reject("filtered", window=start, detail=f"{self.layer} {touched.label} ({at})"))
        return rejects

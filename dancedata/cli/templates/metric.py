"""template_name: how far the root of a dancer gets from where it starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.core.dance import Dance, Undefined
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Better, Metric
from dancedata.core.registry import METRICS
from dancedata.core.rotations import Float64Array


@METRICS.register("template_name")
@dataclass(frozen=True)
class TemplateName(Metric):
    """Largest horizontal distance of the root from its first position, metres.

    Attributes
    ----------
    least_s
        Shorter clips have no value, seconds.
    """

    version: ClassVar[int] = 1  # raise it whenever the same dance gives other numbers
    source: ClassVar[str] = "paper and equation, or repository and file"
    better: ClassVar[dict[str, Better]] = {"template_name": "closer"}

    least_s: float = 1.0

    def __post_init__(self) -> None:
        """Check the parameters."""
        if not self.least_s >= 0:
            raise UsageError("least_s must be at least 0", found=self.least_s)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the numbers of a clip."""
        return ("template_name",)

    def measure(self, dance: Dance) -> Float64Array:
        """Return the numbers of one clip, (1,); +Y is up, joint 0 is the root."""
        if dance.n_frames < self.least_s * dance.fps:
            raise Undefined("short", found=f"{dance.n_frames} frames")
        path = dance.joints[:, 0, [0, 2]]
        return np.array([np.linalg.norm(path - path[0], axis=1).max()])

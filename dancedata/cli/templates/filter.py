"""template_name: leaves out windows with extreme values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.core.clip import Reject
from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import Float32Array, WindowFilter
from dancedata.core.registry import FILTERS


@FILTERS.register("template_name")
@dataclass(frozen=True)
class TemplateName(WindowFilter):
    """Keeps a window if no value of a field is larger than a limit.

    Attributes
    ----------
    limit
        Largest absolute value that is kept.
    field
        Motion or key motion field that is inspected.
    """

    version: ClassVar[int] = 1  # raise it whenever different windows are kept, and build with --overwrite

    limit: float = 100.0
    field: str = "edge151"

    def __post_init__(self) -> None:
        """Check the parameters; an error here is a problem of the recipe."""
        if not self.limit > 0:
            raise UsageError("limit must be above 0", found=self.limit)

    def reject(self, rows: Float32Array, columns: Columns, grid: FrameGrid) -> Reject | None:
        """Return why a window (L, D) is left out; None if it is kept."""
        largest = float(np.abs(rows).max())
        if largest <= self.limit:
            return None
        detail = f"{self.field} has a value of {largest:.5g}, the limit is {self.limit:g}"
        return Reject(self.reason, detail=detail, numbers={"largest": largest})

"""The movement filter: windows in which hardly anything moves are left out."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.clip import Reject
from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import Float32Array, WindowFilter
from dancedata.core.registry import FILTERS
from dancedata.core.typing import override

#: Lodge's and FineDance's threshold.
MIN_STD = 0.07
_SPLITS = ("train", "val", "test", "all")


@FILTERS.register("movement")
@dataclass(frozen=True)
class Movement(WindowFilter):
    """Keeps a window if the mean over columns of their standard deviation in time is above a limit.

    As Lodge and FineDance choose training windows, on columns that are not normalised, contacts included;
    test windows they keep all.

    Attributes
    ----------
    min_std
        Limit, exclusive.
    field
        Motion field that is measured: lodge139 in Lodge, finedance319 in FineDance.
    splits
        Splits that are filtered.
    """

    reason: ClassVar[str] = "still"

    min_std: float = MIN_STD
    field: str = "lodge139"
    splits: tuple[Literal["train", "val", "test", "all"], ...] = ("train",)

    def __post_init__(self) -> None:
        number = isinstance(self.min_std, int | float) and not isinstance(self.min_std, bool)
        if not number or not self.min_std >= 0 or not np.isfinite(self.min_std):
            raise UsageError("min_std must be a number of at least 0", found=repr(self.min_std))
        if isinstance(self.splits, str) or not set(self.splits) <= set(_SPLITS):
            raise UsageError("splits must be a list of splits", found=repr(self.splits), allowed=", ".join(_SPLITS))

    @override
    def reject(self, rows: Float32Array, columns: Columns, grid: FrameGrid) -> Reject | None:
        # In the rows' own dtype, float32, as the references compute it: windows near the limit fall on their side.
        std = float(rows.std(axis=0).mean())
        if std > self.min_std:
            return None
        detail = f"{self.field} hardly moves: mean standard deviation {std:.5g}, the limit is {self.min_std:g}"
        return Reject(self.reason, detail=detail, numbers={"std": std})

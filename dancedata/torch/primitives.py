"""Lodge's primitives of the windows of a reader."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.plugins import PrimitiveFinder
from dancedata.core.registry import PRIMITIVE_FINDERS
from dancedata.store.dataset import Store
from dancedata.torch.options import Primitives, Variant, clash


@lru_cache(maxsize=1)
def _finder() -> PrimitiveFinder:
    return PRIMITIVE_FINDERS.only()


@dataclass(frozen=True)
class PrimitiveSpec:
    """Computation of primitives of `n` frames from the windows of a field, with stored key motions or without."""

    field: str  # motion field that they are rows of
    key_motion: str | None  # field of the clip's minima; None for variant "code" and windows of n frames
    n: int  # frames of a local segment
    variant: Variant

    def of(
        self, rows: npt.NDArray[Any], bias: int, key_motion: npt.NDArray[Any] | None
    ) -> dict[str, npt.NDArray[Any]]:
        """Return the primitives of a window's rows (N, D), mirrored but not normalised, as entries of a sample."""
        return _finder().find(rows, self.n, self.variant, bias, key_motion)


def primitive_spec(
    store: Store, fields: Sequence[str], length: int, asked: Primitives, scaled: Sequence[str]
) -> PrimitiveSpec:
    """Return the fields of primitives of windows of `length` frames; UsageError where they cannot be computed."""
    motion = [f.name for f in map(store.field, fields) if f.kind == "motion" and f.rate == store.fps]
    if not motion:
        raise UsageError(
            "primitives need a motion field to be read with them", found=", ".join(fields), fix="read lodge139"
        )
    if length % asked.n:
        raise clash(f"windows of {length} frames", asked, "a window is a whole number of local segments")
    whole_window = length == asked.n
    names = [f.name for f in store.fields_with(kind="keymotion")]
    reads = asked.variant == "paper" and not whole_window
    if reads and not names:
        raise UsageError("the store does not hold key motions", where=str(store.path),
                         fix="build with keymotion: {lodge: {}}, or take Primitives(variant='code')")  # fmt: skip
    if motion[0] in scaled and asked.variant == "code" and not whole_window:
        raise clash(asked, f"scaled {motion[0]}", "variant 'code' makes the root relative to each piece's first "
                    "frame, and the scaler was fitted on absolute positions; scale afterwards")  # fmt: skip
    return PrimitiveSpec(motion[0], names[0] if reads else None, asked.n, asked.variant)

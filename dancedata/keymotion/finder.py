"""Lodge's primitives of the windows of a reader."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.plugins import PRIMITIVES, PrimitiveFinder
from dancedata.core.registry import PRIMITIVE_FINDERS
from dancedata.core.typing import override
from dancedata.keymotion.characteristic_primitives import Variant, borders, primitives
from dancedata.metrics.key_motion import KeyMotion


@PRIMITIVE_FINDERS.register("characteristic")
@dataclass(frozen=True)
class CharacteristicPrimitives(PrimitiveFinder):
    """The 4 + 4 border frames of a window of one local segment; hard and soft cues of a longer one."""

    @override
    def find(
        self, rows: npt.NDArray[Any], n: int, variant: Variant, bias: int, key_motion: npt.NDArray[Any] | None
    ) -> dict[str, npt.NDArray[Any]]:
        length = len(rows)
        if length == n:
            return {PRIMITIVES: borders(rows)}
        if key_motion is None:
            cues = primitives(rows, length, n, variant=variant, bias=bias)
        else:
            stored = KeyMotion.from_rows(key_motion)
            cues = primitives(rows, length, n, minima=stored.minima, prominence=stored.prominence)
        return {
            PRIMITIVES: cues.frames,
            "primitive_start": np.asarray(cues.start, dtype=np.int64),
            "primitive_hard": np.asarray(cues.hard, dtype=np.bool_),
            "primitive_filled": np.asarray(cues.filled, dtype=np.bool_),
        }

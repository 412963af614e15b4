"""Lodge's primitives as a part of samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.errors import UsageError
from dancedata.keymotion.characteristic_primitives import Variant, borders, primitives
from dancedata.keymotion.minima import KeyMotion
from dancedata.store.dataset import Store

#: The name under which `fields` asks for primitives.
PRIMITIVES = "primitives"


@dataclass(frozen=True)
class PrimitiveSpec:
    """How primitives are computed from the windows of a field.

    Attributes
    ----------
    field
        Motion field that they are rows of.
    key_motion
        Key motion field that holds the clip's minima; None for variant "code", which uses only the window.
    n
        Frames of a local segment. A window of n frames gets its 4 + 4 border frames, a longer one hard and
        soft cues.
    """

    field: str
    key_motion: str | None
    n: int
    variant: Variant

    def refuse_scaling(self, length: int) -> None:
        """Raise UsageError if primitives of windows of `length` frames cannot be normalised."""
        if self.variant == "code" and length != self.n:
            raise UsageError(
                "variant code makes the root relative to each piece's first frame, which cannot be normalised: the "
                "scaler was fitted on absolute positions",
                fix="pass normalize=False and scale afterwards, or take primitive_variant='paper'",
            )

    def of(self, store: Store, window: Window, rows: npt.NDArray[Any], bias: int) -> dict[str, npt.NDArray[Any]]:
        """Return the primitives of a window's rows (N, D), mirrored but not normalised, as entries of a sample."""
        if window.length == self.n:
            return {PRIMITIVES: borders(rows)}
        if self.key_motion is None:
            found = primitives(rows, window.length, self.n, variant=self.variant, bias=bias)
        else:
            known = KeyMotion.from_rows(store.read(window, self.key_motion))
            found = primitives(rows, window.length, self.n, minima=known.minima, prominence=known.prominence)
        return {
            PRIMITIVES: found.frames,
            "primitive_start": np.asarray(found.start, dtype=np.int64),
            "primitive_hard": np.asarray(found.hard, dtype=np.bool_),
            "primitive_filled": np.asarray(found.filled, dtype=np.bool_),
        }


def primitive_spec(store: Store, fields: tuple[str, ...], length: int, n: int, variant: Variant) -> PrimitiveSpec:
    """Return the fields and lengths for primitives, and check them.

    Raises
    ------
    UsageError
        If no motion field at the store's rate is read, or the store does not hold key motions.
    """
    motion = [f.name for f in map(store.field, fields) if f.kind == "motion" and f.rate == store.fps]
    if not motion:
        raise UsageError("primitives need a motion field beside them", found=", ".join(fields), fix="read lodge139")
    if length % n:
        raise UsageError(
            "a window is not a whole number of local segments",
            found=f"windows of {length} frames, primitive_n={n}",
            fix="choose a primitive_n that divides the window's length",
        )
    names = [f.name for f in map(store.field, store.fields) if f.kind == "keymotion"]
    if variant == "paper" and length != n and not names:
        raise UsageError(
            "the store does not hold key motions",
            where=str(store.path),
            fix="build with keymotion: {lodge: {}}, or take primitive_variant='code'",
        )
    return PrimitiveSpec(motion[0], names[0] if variant == "paper" and names else None, n, variant)

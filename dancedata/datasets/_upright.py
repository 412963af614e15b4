"""The axis that is up in files that do not state it: that along which heads are above pelvises."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError

#: Least cosine between the mean vector from pelvis to head and the axis that is taken as up.
UPRIGHT_COSINE = 0.8


def up_axis(path: Path, spine: NDArray[np.float64], up: str, dataset: str, axes: Sequence[str] = ("y", "z")) -> str:
    """Return the axis that is up in a file.

    `spine`: (3,) vector from pelvis to head in the file's axes, on average.
    `up`: What the recipe states: one of `axes`, or "auto".
    `axes`: The axes that are accepted, such as "y" and "-y".
    Raises DataError: ``bad_axes`` where the spine does not say so clearly, or clearly contradicts `up`.
    """
    cosines = dict(zip("xyz", spine / max(float(np.linalg.norm(spine)), 1e-9), strict=True))
    clear = next((axis for axis, value in cosines.items() if abs(value) >= UPRIGHT_COSINE), "")
    clear = f"-{clear}" if clear and cosines[clear] < 0 else clear
    if up != "auto" and clear in ("", up):
        return up
    if up == "auto" and clear in axes:
        return clear
    signed = [axis if axis.startswith("-") else f"+{axis}" for axis in axes]
    stated = up if up.startswith("-") else f"+{up}"
    raise DataError(
        "the axis that is up is not clear" if up == "auto" else f"heads are not above pelvises along {stated}",
        reason="bad_axes",
        where=str(path),
        found="cosines of the spines " + ", ".join(f"{axis} {value:.2f}" for axis, value in cosines.items()),
        allowed=f"at least {UPRIGHT_COSINE} along {' or '.join(signed)}",
        fix=f"set dataset.{dataset}.up to the axis that is up, {' or '.join(axes)}, or leave the file out",
    )

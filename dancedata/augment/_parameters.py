"""Checks that augmentations share: of their parameters, and of the fields of samples."""

import math

from dancedata.core.columns import Spatial
from dancedata.core.errors import UsageError
from dancedata.core.plugins import SampleField


def require_number(what: str, value: float, low: float, high: float, unit: str) -> None:
    """Raise UsageError unless a parameter is a number from `low` to `high`."""
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not good or not low <= value <= high:
        raise UsageError(f"{what} is out of range", found=value, allowed=f"{low:g} to {high:g} {unit}")


def require_seed(seed: int) -> None:
    """Raise UsageError unless a seed is a whole number >= 0."""
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise UsageError("seed is not a whole number", found=seed, allowed="0 or more")


def spatial_of(field: SampleField) -> Spatial | None:
    """Return how a field's columns follow a turn or a shift; None for key motions, which do not change."""
    if field.kind != "motion":
        return None
    if field.representation is None:
        raise UsageError("its representation is unknown, so places and directions among its columns are unknown too",
                         fix="read a dataset that a recipe of this installation built")  # fmt: skip
    if field.representation.spatial is None:
        raise UsageError(
            f"the representation {field.representation.name} does not define how its columns turn and shift",
            fix="define `spatial` in its class, or store copies: a recipe's augment changes the motion itself",
        )
    return field.representation.spatial

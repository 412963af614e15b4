"""Facts about a motion file: frame rate, up axis, unit, layout, gender.

The first of these that states a fact decides: the manifest (one file), the file itself, the recipe (all files that
do not state it). A fact that none of them states is an error with the declaration to add.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError, did_you_mean
from dancedata.datasets.folder.rates import MAX_RATE, MIN_RATE, rate_of_text
from dancedata.formats.body_model import GENDERS
from dancedata.formats.video_pose import TOOLS

__all__ = [
    "IN_MANIFEST",
    "IN_RECIPE",
    "LAYOUTS",
    "UNITS",
    "UPRIGHT",
    "Declared",
    "Fact",
    "bad_declaration",
    "decide",
    "undeclared",
]

T = TypeVar("T")
Floats = NDArray[np.float64]

LAYOUTS = ("auto", "amass", "smpl", "smplh", "smplx", "finedance", *TOOLS)
#: Metres per unit. "cmu": the files of the CMU database are in inches / 0.45.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "cmu": 0.0254 / 0.45}
GUESS = "guess"
#: Rotation from a file's axes to +Y up, by the file's up axis; -y are a camera's axes, +Z away from it.
UPRIGHT: Mapping[str, Floats] = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-y": np.diag([1.0, -1.0, -1.0]),
}
IN_MANIFEST, IN_RECIPE = "declared in the manifest", "declared in the recipe"


@dataclass(frozen=True)
class Fact(Generic[T]):
    """A fact about a file, and its origin."""

    value: T
    where: str

    def __str__(self) -> str:
        return f"{self.value} ({self.where})"


@dataclass(frozen=True)
class Declared:
    """Declarations for one file or for all; None where nothing is declared.

    Attributes
    ----------
    fps : as text, such as "30" or "30000/1001".
    unit : a name in UNITS, "guess", or metres per unit as text.
    person : the file's own name for one of its people.
    """

    fps: str | None = None
    up: str | None = None
    unit: str | None = None
    layout: str | None = None
    gender: str | None = None
    person: str | None = None

    def problem(self) -> tuple[str, str, str] | None:
        """Return (name, value, allowed values) of the first invalid value; None if all are valid."""
        if self.fps is not None and rate_of_text(self.fps) is None:
            return "fps", self.fps, f"{MIN_RATE} to {MAX_RATE:,} frames per second, such as 30, 59.94 or 30000/1001"
        for name, allowed in (("up", tuple(UPRIGHT)), ("layout", LAYOUTS), ("gender", GENDERS)):
            value = getattr(self, name)
            if value is not None and value not in allowed:
                return name, value, did_you_mean(value, allowed)
        if self.unit is not None and self.unit != GUESS and metres(self.unit) is None:
            return "unit", self.unit, f"{', '.join(UNITS)}, guess (for BVH), or metres per unit, such as 0.0254"
        return None


def metres(unit: str) -> float | None:
    """Return the metres per unit, given by name or as a number above 0; None if it is neither."""
    if unit in UNITS:
        return UNITS[unit]
    if len(unit) > 40:
        return None
    try:
        value = float(unit)
    except ValueError:
        return None
    return value if 1e-6 <= value <= 1e6 else None


def decide(manifest: T | None, file: Fact[T] | None, recipe: T | None) -> Fact[T] | None:
    """Return the fact from the manifest, else from the file, else from the recipe."""
    if manifest is not None:
        return Fact(manifest, IN_MANIFEST)
    if file is not None:
        return file
    return None if recipe is None else Fact(recipe, IN_RECIPE)


def decide_rate(manifest: Declared, file: Fact[Fraction] | None, recipe: Declared) -> Fact[Fraction] | None:
    """Return the frame rate as `decide` does."""
    return decide(_rate(manifest), file, _rate(recipe))


def _rate(declared: Declared) -> Fraction | None:
    return None if declared.fps is None else rate_of_text(declared.fps)


def undeclared(path: Path, key: str, what: str, allowed: str, found: str, also: Sequence[str] = ()) -> DataError:
    """Return the DataError for an unknown fact; `also`: keys of further unknown facts, to declare as well."""
    others = f". Declare {' and '.join(also)} as well, also unknown" if also else ""
    return DataError(
        f"the {what} of this file is unknown",
        reason="undeclared",
        where=str(path),
        found=found,
        allowed=allowed,
        fix=f"declare {key}: in a column of the manifest, or for all files in the recipe "
        f"(--set dataset.folder.{key}=...){others}",
    )


def bad_declaration(path: Path, problem: str, found: str, allowed: str, fix: str) -> DataError:
    """Return the DataError for a declaration that contradicts its file."""
    return DataError(problem, reason="bad_declaration", where=str(path), found=found, allowed=allowed, fix=fix)

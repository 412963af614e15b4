"""Facts about a motion file: frame rate, up axis, unit, layout, gender.

The manifest decides (one file), else the file, else the recipe (files that do not state the fact), else an error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError, did_you_mean
from dancedata.formats.body_model import GENDERS
from dancedata.formats.stated import MAX_RATE, MIN_RATE, UNITS, UPRIGHT, metres, rate_of_text
from dancedata.formats.video_pose import TOOLS

T = TypeVar("T")
Floats = NDArray[np.float64]

LAYOUTS = ("auto", "amass", "smpl", "smplh", "smplx", "finedance", *TOOLS, "motionx", "humanml3d", "positions")
GUESS = "guess"
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

    `fps`: As text, such as "30" or "30000/1001".
    `unit`: A name in UNITS, "guess", or metres per unit as text.
    `person`: The file's own name for one of its people.
    `joint_map`: SMPL joint -> name in the BVH, or the name of a producer, as JSON.
    """

    fps: str | None = None
    up: str | None = None
    unit: str | None = None
    layout: str | None = None
    gender: str | None = None
    person: str | None = None
    joint_map: str | None = None

    @property
    def rate(self) -> Fraction | None:
        """The frame rate."""
        return None if self.fps is None else rate_of_text(self.fps)

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


def decide(manifest: T | None, file: Fact[T] | None, recipe: T | None) -> Fact[T] | None:
    """Return the fact from the manifest, else from the file, else from the recipe."""
    if manifest is not None:
        return Fact(manifest, IN_MANIFEST)
    if file is not None:
        return file
    return None if recipe is None else Fact(recipe, IN_RECIPE)


def undeclared(path: Path, key: str, what: str, allowed: str, found: str, also: Sequence[str] = ()) -> DataError:
    """Return the DataError for an unknown fact; `also`: keys of further unknown facts, to declare as well."""
    others = f". Declare {' and '.join(also)} as well, also unknown" if also else ""
    return DataError(f"the {what} of this file is unknown", reason="undeclared", where=str(path), found=found,
                     allowed=allowed,
                     fix=f"declare {key}: in a column of the manifest, or for all files in the recipe "
                     f"(--set dataset.folder.{key}=...){others}")  # fmt: skip


def bad_declaration(path: Path, problem: str, found: str, allowed: str, fix: str) -> DataError:
    """Return the DataError for a declaration that contradicts its file."""
    return DataError(problem, reason="bad_declaration", where=str(path), found=found, allowed=allowed, fix=fix)

"""Facts about a motion file: frame rate, up axis, unit, layout, gender; and the values of its arrays.

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
from dancedata.core.rotations import rotvec_from_matrix
from dancedata.datasets import checks
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.body_model import GENDERS
from dancedata.formats.bvh.hierarchy import MAX_VALUE
from dancedata.formats.stated import MAX_RATE, MIN_RATE, UNITS, UPRIGHT, metres, rate_of_text
from dancedata.formats.video_pose import TOOLS

T = TypeVar("T")
Floats = NDArray[np.float64]

#: Tolerance of the orthonormality of rotation matrices; float16 is within 2e-3.
_TOLERANCE = 1e-2
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
    """Declarations for one file or for all, as text; None where nothing is declared.

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


def finite(arrays: ArrayFile, name: str) -> Floats:
    """Return one array as (T, columns), checked for frames, NaN and infinity."""
    shape = arrays.shape(name)
    if len(shape) < 2:
        raise bad_shape(arrays, name, "frames x columns")
    if 0 in shape:
        fix = "remove the file, or save it again"
        raise DataError("the motion has no frames", reason="empty", where=str(arrays.path), found=str(shape), fix=fix)
    array = arrays.read(name).reshape(shape[0], -1)
    checks.require_finite(arrays.path, name or "the array", array, "remove these frames, or the file")
    if np.abs(array).max() > MAX_VALUE:
        frame = int(np.abs(array).max(axis=1).argmax())
        raise DataError(f"{name or 'the array'} contains numbers outside the range of angles and lengths",
                        reason="out_of_range", where=f"{arrays.path}, frame {frame}",
                        found=f"{np.abs(array[frame]).max():.3g}", allowed=f"numbers within +-{MAX_VALUE:g}",
                        fix="save the file again")  # fmt: skip
    return array


def bad_shape(arrays: ArrayFile, name: str, allowed: str, fix: str | None = None) -> DataError:
    """Return the DataError for an array of another shape."""
    fix = fix or "save the motion in one of these layouts"
    return checks.bad_shape(arrays.path, name or "the array", arrays.shape(name), allowed, fix)


def scales(arrays: ArrayFile, name: str, n_frames: int) -> Floats:
    """Return (1, 1) or (T, 1): what divides the translation: numbers, or a camera's first column; DataError."""
    values = arrays.read(name)
    columns = (
        values.reshape(1, 1) if values.size == 1 else values[:, :1] if values.ndim == 2 else values.reshape(-1, 1)
    )
    if (
        columns.shape not in ((1, 1), (n_frames, 1))
        or values.ndim > 2
        or not ((columns >= 1e-6) & (columns <= 1e6)).all()
    ):
        raise DataError(f"{name or 'the array'} cannot scale the translation", reason="bad_scaling",
                        where=str(arrays.path),
                        found=f"shape {values.shape}, from {columns.min(initial=np.inf):.3g} to "
                        f"{columns.max(initial=-np.inf):.3g}",
                        allowed=f"one number, ({n_frames},), or ({n_frames}, 3) with the scale first; above 0",
                        fix="correct it, or name another key scale in dataset.folder.keys")  # fmt: skip
    return columns


def from_matrices(arrays: ArrayFile, name: str, values: Floats) -> Floats:
    """Return axis-angle rotations (T, J, 3) of matrices (T, J * 9), row by row; DataError (``bad_rotation``)."""
    matrices, fix = values.reshape(len(values), -1, 3, 3), "give the array that has rotation matrices, or axis-angle"
    joints = [str(joint) for joint in range(matrices.shape[1])]
    # Matrices that are orthonormal within t have determinants within 5 t of 1 or -1: this refuses reflections alone.
    checks.require_matrices(f"{arrays.path}, {name}", matrices, joints, _TOLERANCE, 5 * _TOLERANCE, fix)
    return rotvec_from_matrix(matrices)

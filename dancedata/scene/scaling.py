"""The scaler of columns, if any: what a call or a file states, checked against the columns."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.plugins import Representation
from dancedata.formats.arrays import UNSTATED, StatedScaling
from dancedata.kernel import Scaler

_log = logging.getLogger(__name__)
#: Mean distance from unit length, and relative one from a bone's length, of motion that a good model generates.
_UNIT, _BONE = 0.03, 0.15
#: The stated choice is wrong if its distance is above this plus 3 times that of the other choice.
_WORSE = 0.02
#: A stated choice that is off by more than this, and by 3 times the other choice if there is one, gives a warning;
#: so does one where both are off.
_DOUBT = 0.1
#: Mean distance from the usual range of motion in its own units, after normalising; and of values of no scaler.
_INSIDE, _FAR = 0.05, 10.0
#: Mean size of values that are about 0.
_NEAR_0 = 0.1


@dataclass(frozen=True, eq=False)
class Scaling:
    """Scaling of the columns of a field."""

    scaler: Scaler | None = None  # the scaler that normalised columns have; None if nothing names one
    normalized: bool | None = None  # whether columns are normalised; None if only their file can state that
    clamp: bool = False  # whether normalised values are cut to [-1, 1] first, as EDGE and Lodge do

    def identity(self) -> Any:
        """Return JSON data for cache keys."""
        return None if self.scaler is None else [self.scaler.sha256, self.normalized, self.clamp]

    @staticmethod
    def unstated(where: object = None) -> UsageError:
        """Return the error for columns of which nothing states whether they are normalised."""
        return UsageError("nothing states whether these columns are normalised", where=where, reason="not_stated",
                          fix="state it: normalized=True or normalized=False",
                          options="state it: --normalized or --not-normalized")  # fmt: skip

    def undone(
        self,
        columns: npt.NDArray[Any],
        representation: Representation,
        *,
        file: StatedScaling = UNSTATED,
        where: Any = None,
    ) -> tuple[npt.NDArray[Any], str]:
        """Return columns (..., D) as they are stored, float64 if they were normalised; and why that is doubtful."""
        normalized = self.normalized if file.normalized is None else file.normalized
        if self.scaler is not None and self.normalized not in (None, normalized):
            raise UsageError("the file and the call differ in whether the columns are normalised", where=where,
                             found=f"normalized={file.normalized} in the file",
                             allowed=f"normalized={self.normalized}")  # fmt: skip
        if normalized and self.scaler is not None and file.scaler not in ("", self.scaler.sha256):
            raise UsageError("the columns are normalised by another scaler than the one named", where=where,
                             found=f"scaler {file.scaler[:12]} in the file", allowed=self.scaler.sha256[:12],
                             fix="name that of the training, the scaler.json beside saved samples")  # fmt: skip
        if self.scaler is None:
            if file.normalized:
                raise UsageError(
                    "the file states that its columns are normalised, and no scaler is named", where=where,
                    fix="name it: like= or scaler=", options="name it: --like DATASET or --scaler FILE",
                )  # fmt: skip
            off, limit = _distance(_rows(columns), representation)
            if limit != _UNIT or not off > _DOUBT:  # bones may be those of another body
                return columns, ""
            _warn_once(f"vectors of {representation.name}, taken as not normalised, are far off unit length")
            return columns, f"vectors are {off:.0%} off unit length"
        if normalized is None:
            raise self.unstated(where)
        rows = np.asarray(columns, dtype=np.float64)
        doubt = _check(_rows(rows), representation, self.scaler, normalized, where)
        if not normalized:
            return columns, doubt
        undone: npt.NDArray[Any] = self.scaler.unnormalize(rows, clamp=self.clamp)
        return np.where(np.isfinite(rows), undone, np.nan), doubt  # clipping would hide infinity


def _rows(columns: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Return columns (..., D) as (N, D), with nan for infinity, and within what can be squared."""
    rows = np.asarray(columns, dtype=np.float64).reshape(-1, columns.shape[-1])
    return np.where(np.isfinite(rows), rows.clip(-1e9, 1e9), np.nan)


@cache
def _warn_once(text: str) -> None:
    _log.warning("%s; name the dataset or the scaler of the training, if they are normalised", text)


def _check(
    rows: npt.NDArray[np.float64], representation: Representation, scaler: Scaler, normalized: bool, where: Any
) -> str:
    """Raise UsageError if rows (N, D) are clearly not as stated; return why it is doubtful, "" where it is not.

    They are not if the other choice, and it alone, gives what motion has: vectors of 6D and matrices of unit length,
    bones of the skeleton's length, values within the range of the scaler. The output of a network that is not
    trained has that with neither choice, or is near 0, and passes; with a warning where the other choice is far
    better.
    """
    if not np.isfinite(rows).any():
        return ""
    (distance, least), (undone, _) = (_distance(r, representation) for r in (rows, scaler.unnormalize(rows)))
    stated, other = (undone, distance) if normalized else (distance, undone)
    words = ("normalised", "not normalised")
    is_better = stated > max(_DOUBT, 3 * other)
    doubt, problem = "", ""
    if least == _UNIT and stated > _DOUBT:
        fit = f"columns fit {words[normalized]!r} better"
        doubt = fit if is_better else f"vectors are {stated:.0%} off unit length"
    if _mean(np.abs(rows)) < _NEAR_0:
        return doubt
    range_ = np.tile(np.linspace(-1, 1, 5)[:, None], scaler.width)
    narrows = _outside(scaler.normalize(range_ * scaler.usual), scaler.usual) > 3 * _INSIDE
    again, outside = _outside(scaler.normalize(rows), scaler.usual), _outside(rows, scaler.usual)
    scaled = narrows and again > 3 * _INSIDE and outside < _INSIDE
    if other < least and (stated > _WORSE + 3 * other or (scaled and not normalized and stated > other)):
        problem = f"vectors or bones {stated:.1%} off their length; {other:.1%} with the other choice"
    if normalized and not problem and ((narrows and again < _INSIDE) or outside > _FAR):
        problem = f"values from {np.nanmin(rows):.3g} to {np.nanmax(rows):.3g}, which are not of this scaler"
    name = f"vectors or bones of {representation.name}, stated to be {words[not normalized]}"
    if not problem and is_better:
        _warn_once(f"{name}, are far off their length, and nearer to it with the other choice")
    elif not problem and stated > max(_DOUBT, 1.5 * least):  # bones may be those of another body
        _warn_once(f"{name}, are far off their length with either choice: an untrained model, or another scaler")
    if problem:
        fix = f"if they are {words[normalized]}: "
        raise UsageError(f"the columns are stated to be {words[not normalized]}, but look {words[normalized]}",
                         where=where, found=problem,
                         fix=f"{fix}normalized={not normalized}",
                         options=fix + ("--normalized", "--not-normalized")[normalized])  # fmt: skip
    return doubt


def _outside(rows: npt.NDArray[np.float64], usual: float) -> float:
    """Return the mean distance of values from [-usual, usual]."""
    return _mean(np.maximum(np.abs(rows) - usual, 0))


def _mean(values: npt.NDArray[np.float64]) -> float:
    """Return the mean of the finite values; nan without one."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def _distance(rows: npt.NDArray[np.float64], representation: Representation) -> tuple[float, float]:
    """Return the mean distance of lengths in rows (N, D) from those in motion, each divided by it, and a limit."""
    columns, skeleton = representation.columns, representation.skeleton
    for name in columns.names:
        if name.startswith(("rotation_6d", "rotation_matrix")):
            vectors = rows[:, columns.slice(name)].reshape(len(rows), -1, 3)
            return _mean(np.abs(np.linalg.norm(vectors, axis=-1) - 1)), _UNIT
    if "position" not in columns.names:
        return float("nan"), 0.0
    joints = rows[:, columns.slice("position")].reshape(len(rows), -1, 3)
    length = np.linalg.norm(skeleton.offsets[1:], axis=1)
    bones = np.linalg.norm(joints[:, 1:] - joints[:, list(skeleton.parents[1:])], axis=-1)
    has_length = length > 0
    return _mean(np.abs(bones[:, has_length] / length[has_length] - 1)), _BONE

"""Decoder: columns of one motion, of a batch or of a group of dancers, back to motions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.core.grid import FrameGrid, Number
from dancedata.core.motion import Motion
from dancedata.core.plugins import Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.formats.arrays import UNSTATED, StatedScaling
from dancedata.formats.stated import same_rate
from dancedata.kernel import Store, make_named
from dancedata.scene.like import DatasetLike, ScalerLike, opened, scaling_of, store_of

#: The representation that holds the places of dancers.
_PLACES = "root_place"


@dataclass(frozen=True)
class Decoder:
    """A representation, and what a call and a file state of the scaling of its columns and their rate."""

    field: str  # name of the representation, or of the field of `like` with it
    representation: Representation
    fps: Number | None
    like: DatasetLike
    normalized: bool | None
    scaler: ScalerLike
    clamp: bool
    # `file`, `grid`: what the file states of the scaling of its columns, and the rate that it states; None if it does
    # not
    file: StatedScaling = UNSTATED
    grid: FrameGrid | None = None

    @classmethod
    def of(
        cls, field: str, parameters: dict[str, Any], fps: Number | None, like: DatasetLike, normalized: bool | None,
        scaler: ScalerLike, clamp: bool,
    ) -> Decoder:  # fmt: skip
        """Return the decoder of a call; `decode` says what is refused."""
        name, _ = REPRESENTATIONS.split(field)
        plugin = make_named(REPRESENTATIONS, "motion", name, parameters)
        return cls(field, plugin, fps, like, normalized, scaler, clamp)

    def motions(self, array: Any) -> Motion | list[Motion]:
        """Decode columns (T, D), or a batch (B, T, D)."""
        self._require_decodable()
        array = _numbers(array, self.field)
        self._require_shape(array, (2, 3))
        stored, grid = self._undone(array)
        if stored.ndim == 2:
            return self.representation.decode(stored, grid)
        return [self._motion(one, grid, f"motion {number} of the batch") for number, one in enumerate(stored)]

    def group(self, array: Any, person_mask: Any, place: Any) -> list[Motion | None]:
        """Decode the columns (P, T, D) of a group; see `decode`."""
        self._require_decodable()
        array = _numbers(array, self.field)
        self._require_shape(array, (3,))
        present = self._present(array, person_mask)
        places = self._places(array, place, present)
        motions: list[Motion | None] = [None] * len(array)
        stored, grid = self._undone(array[present])
        for row, number in enumerate(np.flatnonzero(present)):
            motion = self._motion(stored[row], grid, f"dancer {number}")
            motions[number] = motion if places is None else _places().placed(motion, places[row])
        return motions

    def _present(self, array: npt.NDArray[Any], person_mask: Any) -> npt.NDArray[np.bool_]:
        if person_mask is None:
            absent = np.flatnonzero(~array.any(axis=(1, 2)))
            if len(absent):
                raise DataError(
                    "a dancer's rows are all 0", reason="bad_shape", where=f"dancer {absent[0]}",
                    fix="pass the batch's person_mask as mask: it says which rows of 0 are absent dancers",
                )  # fmt: skip
            return np.ones(len(array), np.bool_)
        mask = np.asarray(person_mask)
        if mask.shape != array.shape[:1] or not np.isin(mask, (0, 1)).all() or not mask.any():
            raise UsageError("mask does not fit the columns",
                             found=f"shape {mask.shape}, values {np.unique(mask).tolist()}",
                             allowed=f"({len(array)},), 0 or 1, not all 0")  # fmt: skip
        return mask.astype(np.bool_)

    def _places(self, array: npt.NDArray[Any], place: Any, present: npt.NDArray[np.bool_]) -> npt.NDArray[Any] | None:
        """Return rows (P, T, 6) of those present, not normalised; None for columns that hold places themselves."""
        spatial = self.representation.spatial
        placeless = spatial is not None and spatial.placeless
        if (place is not None) != placeless:
            raise UsageError(
                f"the columns of {self.field} have no places" if placeless else f"{self.field} holds places itself",
                fix="pass place=, the columns of the field root_place; in a file, an array root_place"
                if placeless else "leave out the columns of root_place",
            )  # fmt: skip
        if place is None:
            return None
        rows = _numbers(place, "root_place")
        if rows.shape != (*array.shape[:2], 6):
            raise UsageError(
                "the places do not fit the columns", found=f"shape {rows.shape}", allowed=f"{(*array.shape[:2], 6)}"
            )
        if self.scaler is not None:
            raise UsageError(
                "a scaler of one field does not normalise root_place",
                fix="name the reader or dataset of both fields: like=",
                options="name the dataset of both fields: --like DATASET",
            )
        file = StatedScaling(self.file.normalized)  # whose scaler is that of the other columns
        return replace(self, field=_PLACES, representation=_places(), file=file)._undone(rows[present])[0]

    def _undone(self, array: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], FrameGrid]:
        """Return columns as they are stored, and their rate."""
        like = None if self.like is None else opened(self.like)
        grid = _grid(self.representation, self.field, self.fps, None if like is None else store_of(like), self.grid)
        scaling = scaling_of(
            like, self.field, self.representation.columns.labels, normalized=self.normalized, scaler=self.scaler,
            clamp=self.clamp,
        )  # fmt: skip
        return scaling.undone(array, self.representation, file=self.file)[0], grid

    def _motion(self, array: npt.NDArray[Any], grid: FrameGrid, where: str) -> Motion:
        try:
            return self.representation.decode(array, grid)
        except DanceDataError as error:
            error.where = where + (f", {error.where}" if error.where else "")
            raise

    def _require_decodable(self) -> None:
        if not self.representation.decodes:
            raise UsageError(
                f"{self.field} cannot be decoded: positions do not determine how a bone turns about its own axis",
                fix="use the positions unchanged, or store a representation that holds rotations as well",
            )

    def _require_shape(self, array: npt.NDArray[Any], dimensions: tuple[int, ...]) -> None:
        width = self.representation.columns.width
        if array.ndim not in dimensions or array.shape[-1] != width or 0 in array.shape:
            raise UsageError(
                f"these are not columns of {self.field}",
                found=f"shape {array.shape}",
                allowed=f"(T, {width}) or a batch (B, T, {width}), not empty"
                if 2 in dimensions else f"a group (P, T, {width}), not empty",
                fix=_named_by_width(array.shape[-1])
                if array.ndim in dimensions and array.shape[-1] != width else None,
            )  # fmt: skip


def _places() -> Representation:
    return REPRESENTATIONS.make(_PLACES, {})


def _numbers(array: Any, name: str) -> npt.NDArray[Any]:
    try:
        numbers = np.asarray(array)
        problem = "" if numbers.dtype.kind in "iuf" else f"dtype {numbers.dtype}"
    except (TypeError, ValueError, RuntimeError) as error:  # lists of unequal length; tensors that numpy cannot hold
        problem = str(error)
    if problem:
        fix = "pass a numpy array: tensor.detach().cpu().float().numpy()"
        raise UsageError(f"these are not columns of {name}", found=problem, allowed="floats or integers", fix=fix)
    return numbers


def _named_by_width(width: int) -> str | None:
    fitting = [n for n in REPRESENTATIONS.names() if REPRESENTATIONS.get(n)().columns.width == width]
    return f"{width} columns are those of {' or '.join(fitting)}" if fitting else None


def _grid(
    plugin: Representation, name: str, fps: Number | None, store: Store | None, file: FrameGrid | None
) -> FrameGrid:
    stored = None if store is None else FrameGrid(store.field(name).rate)
    grid = FrameGrid.of(fps) if fps is not None else stored or file or FrameGrid(plugin.rate or FrameGrid.of(30).rate)
    if not same_rate(file, grid):
        raise DataError("the file states a different rate", reason="bad_rate", found=f"{file} frames per second",
                        allowed=f"{grid}, the rate of fps or of the dataset",
                        fix="omit fps or the dataset if it is wrong, or save the file at its true rate")  # fmt: skip
    if stored is not None and grid != stored:
        raise UsageError(f"{name} has a different rate in the dataset", where=store.path if store else None,
                         found=f"{grid} frames per second", allowed=f"{stored}",
                         fix="omit fps: the rate is the dataset's")  # fmt: skip
    return grid

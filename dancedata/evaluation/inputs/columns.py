"""Columns of a representation as joint positions: of a store's field, or of what a model generated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DataError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import Representation
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed, shown
from dancedata.evaluation.pose import BODIES, Pose
from dancedata.evaluation.protocol import MotionRule
from dancedata.recipes.documents import document_of
from dancedata.recipes.fields import MotionField
from dancedata.recipes.parse import parse_recipe
from dancedata.store import Store
from dancedata.store.scaling import Scaling

__all__ = ["ColumnsReader", "field_readers", "reader_for", "sample_lengths"]

_POSITION = "position"
_AS_STORED = Scaling()


@dataclass(frozen=True, eq=False)
class ColumnsReader:
    """Turns (T, D) columns into a pose.

    Attributes
    ----------
    representation
        Plug-in of the columns.
    grid
        Rate of the rows.
    scaling
        Whether columns are normalised, and by which scaler.
    """

    representation: Representation
    grid: FrameGrid
    scaling: Scaling = _AS_STORED

    def identity(self) -> list[Any]:
        """Return JSON data for cache keys."""
        plugin = self.representation
        return [plugin.name, plugin.version, document_of(plugin), str(self.grid), self.scaling.identity()]

    def problem(self, rule: MotionRule) -> str:
        """Return why the columns cannot give the joints of a protocol; "" if they can."""
        plugin = self.representation
        joints = plugin.skeleton.joints
        is_smpl = joints == SMPL24.joints
        if not plugin.decodes and _POSITION not in plugin.columns.names:
            return "they hold neither rotations nor positions"
        if rule.body == "smplx24" and (is_smpl or (not plugin.decodes and joints[:24] != BODIES["smplx24"][0])):
            return "they are not on SMPL-X with jaw and eyes, or rotations of it"
        if rule.body == "smpl24" and not plugin.decodes and not is_smpl:
            return "they are positions of another body than SMPL's 24 joints"
        if rule.pelvis == "body" and not plugin.decodes and not plugin.skeleton.offsets[0].any():
            return "their pelvis lies at the translation, as EDGE has it"
        grid = rule.grid
        if grid is not None and self.grid.step_to(grid) is None:
            return f"they have {self.grid} rows per second, not {grid} or a whole multiple"
        return ""

    def pose(self, columns: npt.NDArray[Any], *, file: bool | None = None, where: object = None) -> Pose:
        """Return the pose of (T, D) columns; DataError "nan", "bad_rotation" or "bad_shape".

        `file` is what their file states of normalising; UsageError as `Scaling.undo`.
        """
        plugin = self.representation
        rows = np.asarray(columns)
        if rows.ndim != 2 or rows.shape[1] != plugin.columns.width:
            raise DataError(
                f"these are not columns of {plugin.name}",
                reason="bad_shape",
                found=f"shape {rows.shape}",
                allowed=f"(T, {plugin.columns.width})",
            )
        rows = self.scaling.undo(rows, plugin, file=file, where=where)
        if plugin.decodes:
            return Pose.of_motion(plugin.decode(rows, self.grid))
        positions = rows[:, plugin.columns.slice(_POSITION)].reshape(len(rows), -1, 3).astype(np.float64)
        return Pose(positions, plugin.skeleton.joints, self.grid, bool(plugin.skeleton.offsets[0].any()))


def field_readers(store: Store) -> dict[str, ColumnsReader]:
    """Return a reader for each motion field of a store, by the recipe that it was built with.

    Raises
    ------
    UsageError
        If the store's recipe cannot be read: the meaning of its columns is unknown.
    """
    recipe = parse_recipe(store.meta.get("recipe", {}), where=f"{store.path}/dataset.json")
    fields: dict[str, MotionField] = {field.name: field for field in recipe.motion}
    return {
        name: ColumnsReader(fields[name].representation, store.field(name).grid)
        for name in store.fields
        if name in fields
    }


def reader_for(store: Store, rule: MotionRule, field: str | None) -> tuple[str, ColumnsReader]:
    """Choose the motion field of a store to evaluate: the given one, else the first that fits the protocol.

    Raises
    ------
    UsageError
        If there is none, or the given one does not fit, with the reason for each.
    """
    readers = field_readers(store)
    if field is not None and field not in readers:
        raise UsageError(f"no motion field named {field!r}", where=str(store.path), fix=did_you_mean(field, readers))
    asked = {field: readers[field]} if field is not None else readers
    problems = {name: reader.problem(rule) for name, reader in asked.items()}
    for name, problem in problems.items():
        if not problem:
            return name, asked[name]
    any_rate = replace(rule, fps=None)
    only_rate = rule.fps is not None and any(not reader.problem(any_rate) for reader in asked.values())
    raise UsageError(
        "the protocol cannot be computed from this dataset",
        where=str(store.path),
        found="; ".join(f"{name}: {problem}" for name, problem in problems.items()),
        allowed=f"joints {rule.body}" + (f" at {rule.fps} frames per second" if rule.fps else ""),
        fix=f"build it with fps: {rule.fps}, or take a protocol for its rate"
        if only_rate
        else "build it with a field that has them: " + listed(["edge151", "lodge319", "joints"]),
    )


def sample_lengths(batch: npt.NDArray[Any], names: Sequence[str], lengths: npt.NDArray[Any] | None) -> list[int]:
    """Return how many rows each sample of a batch (B, L, D) has: `lengths` (B,), or L.

    Raises
    ------
    UsageError
        For lengths that are not such numbers, or for none where samples are padded.
    """
    if lengths is not None:
        if lengths.shape != batch.shape[:1] or not np.isin(lengths, np.arange(1, batch.shape[1] + 1)).all():
            raise UsageError(
                "lengths are not the rows of each sample", found=shown(lengths),
                allowed=f'{len(batch)} whole numbers from 1 to {batch.shape[1]}, as batch["lengths"][FIELD] has them',
            )  # fmt: skip
        return [int(size) for size in lengths]
    for name, rows in zip(names, batch, strict=True):
        even = (rows == rows[:, :1]).all(axis=1)  # all columns are one number: filled up, and no motion
        if len(rows) and even[-1] and not even.all():
            raise UsageError(
                "a sample is padded: its last rows are one number", where=f"sample {name}",
                found=f"{int(even[::-1].argmin())} rows of {rows[-1, 0]:g}",
                fix='say how long samples are: update(..., lengths=batch["lengths"][FIELD]), as pad_clips gives them',
            )  # fmt: skip
    return [batch.shape[1]] * len(batch)

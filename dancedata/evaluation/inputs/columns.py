"""Which columns of a store a protocol can be computed from, and how long the samples of a batch are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed, shown
from dancedata.evaluation.protocol import MotionRule
from dancedata.recipes.documents import document_of
from dancedata.representations.stored import BODIES, ColumnsReader, motion_reader, motion_readers
from dancedata.store import Store

__all__ = ["columns_identity", "columns_problem", "named_reader", "reader_for", "sample_lengths"]


def columns_problem(reader: ColumnsReader, rule: MotionRule) -> str:
    """Return why the columns cannot give the joints of a protocol; "" if they can."""
    plugin = reader.representation
    joints = plugin.skeleton.joints
    is_smpl = joints == SMPL24.joints
    if not plugin.decodes and "position" not in plugin.columns.names:
        return "they hold neither rotations nor positions"
    if rule.body == "smplx24" and (is_smpl or (not plugin.decodes and joints[:24] != BODIES["smplx24"][0])):
        return "they are not on SMPL-X with jaw and eyes, or rotations of it"
    if rule.body == "smpl24" and not plugin.decodes and not is_smpl:
        return "they are positions of another body than SMPL's 24 joints"
    if rule.pelvis == "body" and not plugin.decodes and not plugin.skeleton.offsets[0].any():
        return "their pelvis lies at the translation, as EDGE has it"
    grid = rule.grid
    if grid is not None and reader.grid.step_to(grid) is None:
        return f"they have {reader.grid} rows per second, not {grid} or a whole multiple"
    return ""


def columns_identity(reader: ColumnsReader) -> list[Any]:
    """Return how columns are read, as JSON data for cache keys."""
    plugin = reader.representation
    return [plugin.name, plugin.version, document_of(plugin), str(reader.grid), reader.scaling.identity()]


def named_reader(store: Store, name: str) -> ColumnsReader:
    """Return the reader of the motion field `name`; UsageError if there is none, or if it cannot be read."""
    names = [field for field in store.fields if store.field(field).kind == "motion"]
    if name not in names:
        raise UsageError(
            f"no motion field named {shown(name)!r}", where=str(store.path), fix=did_you_mean(name, names)
        )
    return motion_reader(store, name)


def reader_for(store: Store, rule: MotionRule, field: str | None) -> tuple[str, ColumnsReader]:
    """Choose the motion field of a store to evaluate: the given one, else the first that fits the protocol.

    Raises
    ------
    UsageError
        If there is none, or the given one does not fit, with the reason for each.
    """
    candidates = motion_readers(store) if field is None else {field: named_reader(store, field)}
    problems = {name: columns_problem(reader, rule) for name, reader in candidates.items()}
    for name, problem in problems.items():
        if not problem:
            return name, candidates[name]
    any_rate = replace(rule, fps=None)
    only_rate = rule.fps is not None and any(not columns_problem(reader, any_rate) for reader in candidates.values())
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

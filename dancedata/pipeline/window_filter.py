"""The window filter of a recipe at building: windows that it leaves out become rejects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dancedata.core.clip import ClipRef, Reject
from dancedata.pipeline.motion import MotionResult
from dancedata.recipes.recipe import Recipe


def filtered_windows(
    recipe: Recipe, ref: ClipRef, motion: MotionResult, starts: tuple[int, ...]
) -> tuple[tuple[int, ...], list[Reject]]:
    """Split a clip's window starts into those that the recipe's filter keeps and a reject for each of the others.

    If it keeps none, the last reject is that of the clip. Without a filter for the clip's split, all are kept.
    """
    chosen = recipe.windows.filter
    if chosen is None or ref.split not in chosen.splits or not starts:
        return starts, []
    rows = np.asarray(motion.arrays[chosen.field])
    field = next(own for own in recipe.clip_fields if own.name == chosen.field)
    length = recipe.grid.rows(recipe.windows.length, of=field.grid)
    kept, rejects = [], []
    for start in starts:
        if recipe.scope == "window":
            window = rows[recipe.windows.number(start)]
        else:
            first = recipe.grid.rows(start, of=field.grid)
            window = rows[first : first + length]
        window.flags.writeable = False
        reject = chosen.reject(window, field.columns, field.grid)
        if reject is None:
            kept.append(start)
        else:
            rejects.append(replace(reject, clip=ref.id, window=start))
    if not kept:
        detail = f"none of the {len(starts)} windows of clip {ref.id} passes the {chosen.name} filter"
        rejects.append(Reject(chosen.reason, ref.id, str(ref.motion_path), detail=detail))
    return tuple(kept), rejects

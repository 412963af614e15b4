"""The movement filter at building: windows in which hardly anything moves become rejects."""

from __future__ import annotations

import numpy as np

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.movement import movement_std
from dancedata.pipeline.motion import MotionResult
from dancedata.recipes.recipe import Recipe


def still_windows(
    recipe: Recipe, ref: ClipRef, motion: MotionResult, starts: tuple[int, ...]
) -> tuple[tuple[int, ...], list[Reject]]:
    """Split a clip's window starts into those that are kept and a reject for each of the others.

    Without a filter in the recipe, or one for this clip's split, all are kept.
    """
    chosen = recipe.windows.filter
    if chosen is None or ref.split not in chosen.splits or not starts:
        return starts, []
    rows = np.asarray(motion.arrays[chosen.field])
    grid = next(own.grid for own in recipe.motion if own.name == chosen.field)
    length = recipe.grid.rows(recipe.windows.length, of=grid)
    kept, rejects = [], []
    for start in starts:
        if recipe.scope == "window":
            window = rows[recipe.windows.number(start)]
        else:
            first = recipe.grid.rows(start, of=grid)
            window = rows[first : first + length]
        std = movement_std(window)
        if chosen.keeps(std):
            kept.append(start)
        else:
            rejects.append(chosen.reject(ref.id, start, std))
    return tuple(kept), rejects

"""Axes of figures, made without a window."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.packages import load

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def axes_or_new(axes: Axes | None, width: float, height: float) -> Axes:
    """Return the given axes, or those of a new figure of this size in inches; no window is opened."""
    if axes is not None:
        return axes
    figure = load("matplotlib.figure", "report", "a figure").Figure(figsize=(width, height), layout="constrained")
    new_axes: Axes = figure.subplots()
    return new_axes

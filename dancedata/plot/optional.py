"""Packages that only figures and videos need."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from dancedata.core.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["axes_or_new", "require"]


def require(module: str, extra: str) -> ModuleType:
    """Return a module; UsageError with the extra to install where it is missing."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        name = module.partition(".")[0]
        raise UsageError(
            f"{name} is not installed", where=module, fix=f"install it: pip install 'dancedata[{extra}]'"
        ) from error


def axes_or_new(axes: Axes | None, width: float, height: float) -> Axes:
    """Return the given axes, or those of a new figure of this size in inches; no window is opened."""
    if axes is not None:
        return axes
    figure = require("matplotlib.figure", "report").Figure(figsize=(width, height), layout="constrained")
    made: Axes = figure.subplots()
    return made

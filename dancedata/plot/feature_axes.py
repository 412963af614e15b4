"""features: the columns of a field over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.plot.optional import axes_or_new
from dancedata.store import Store, open_store
from dancedata.viewer import Scenes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["features"]

#: Inches: width, height without rows, and height of a row, at most so high.
_WIDTH, _BASE, _ROW, _HIGHEST = 8.0, 0.9, 0.055, 9.0
#: Inches between the names of two groups.
_LABEL = 0.15


def features(
    store: Store | str | Path, clip: str, field: str | None = None, *, frame: int = 0, ax: Axes | None = None
) -> Axes:
    """Draw the columns of a field of one clip over time.

    Parameters
    ----------
    store
        A built dataset, open or its folder.
    clip
        Id of a clip.
    field
        Name of a field; default: the first with features of music, else the first of all.
    frame
        In window scope, the first frame of the window.
    ax
        matplotlib axes to draw on; default: those of a new figure, ``ax.figure.savefig(...)`` saves it.

    Returns
    -------
    matplotlib.axes.Axes
        Time in seconds to the right; a line a column, the first at the top, each scaled by its own 2nd and 98th
        percentile. Beats are white lines.

    Raises
    ------
    UsageError
        For an unknown clip or field, and where matplotlib is not installed.

    Examples
    --------
    >>> from dancedata import plot
    >>> plot.features("data/demo", "gBR_sBM_cAll_d04_mBR4_ch03").figure.savefig("features.pdf")
    """
    ds = store if isinstance(store, Store) else open_store(store)
    name = field or next((n for n in ds.fields if ds.field(n).kind == "audio"), next(iter(ds.fields)))
    columns, grid = ds.field(name).columns, ds.field(name).grid
    scenes = Scenes(ds)
    item = scenes.find(clip, frame)
    rows = ds.read_clip(clip, name) if item.window is None else ds.read(item.window, name)
    if not len(rows):
        raise UsageError(f"there are no rows of {name}", where=f"clip {shown(clip)}")
    height = min(_HIGHEST, _BASE + _ROW * columns.width)
    axes = axes_or_new(ax, _WIDTH, height)
    end = float(grid.seconds(len(rows)))
    axes.imshow(
        _scaled(np.asarray(rows, dtype=np.float64)).T,
        aspect="auto",
        interpolation="nearest",
        cmap="magma",
        extent=(0.0, end, columns.width, 0.0),
    )
    beats = scenes.scene(item).rhythm.beats
    axes.vlines(beats[beats < end], 0, columns.width, colors="white", linewidths=0.5, alpha=0.6)
    edges = np.cumsum([0, *(g.width for g in columns.groups)])
    places = _apart((edges[:-1] + edges[1:]) / 2, _LABEL * columns.width / (height - _BASE))
    names = [g.name.replace("_", " ") for g in columns.groups]
    axes.set_yticks(places, names, fontsize="small", parse_math=False)
    axes.set_yticks(edges[1:-1], minor=True)
    axes.tick_params(axis="y", which="major", length=0)
    axes.set_xlabel("seconds")
    axes.set_title(f"{shown(clip)}: {name}", loc="left", fontsize="medium", parse_math=False)
    return axes


def _apart(places: Float64Array, gap: float) -> Float64Array:
    """Move places, ascending, so that they are at least `gap` apart; the last one stays."""
    moved = places.copy()
    for k in range(len(moved) - 2, -1, -1):
        moved[k] = min(moved[k], moved[k + 1] - gap)
    return moved


def _scaled(rows: Float64Array) -> Float64Array:
    """Return every column from 0 to 1 between its 2nd and 98th percentile."""
    low, high = np.percentile(rows, (2, 98), axis=0)
    flat = high <= low
    low, high = np.where(flat, rows.min(axis=0), low), np.where(flat, rows.max(axis=0), high)
    return np.asarray(np.clip((rows - low) / np.where(high > low, high - low, 1.0), 0, 1))

"""features: the columns of a field of one clip over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array, matrix_from_rotvec
from dancedata.core.text import shown
from dancedata.kernel import Store, open_store
from dancedata.plot.dancers import axes_or_new
from dancedata.scene.poses import motion_readers
from dancedata.scene.scenes import Scenes

if TYPE_CHECKING:
    from matplotlib.axes import Axes


#: Inches: width, height without rows, and height of a row; greatest height.
_WIDTH, _BASE, _ROW, _HIGHEST = 8.0, 0.9, 0.055, 9.0
#: Inches between the names of two groups.
_LABEL = 0.15


def features(
    store: Store | str | Path,
    clip: str,
    field: str | None = None,
    *,
    columns: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw the columns of a field of one clip over time; of a motion with rotations a row per joint.

    Parameters
    ----------
    store
        A built dataset, open or its folder.
    clip
        Id of a clip.
    field
        Name of a field; default: the first with features of music, else the first of all.
    columns
        Whether motion with rotations is drawn column by column, too.
    ax
        matplotlib axes to draw on; default: those of a new figure, ``ax.figure.savefig(...)`` saves it.

    Returns
    -------
    matplotlib.axes.Axes
        Time in seconds to the right; a line per column, the first at the top, each scaled by its 2nd and 98th
        percentile. Of motion with rotations a line per joint: the angle of its local rotation from its mean over the
        clip, degrees. Beats are white lines.

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
    groups, grid = ds.field(name).columns, ds.field(name).grid
    scenes = Scenes(ds)
    item = scenes.find(clip)
    if item.members and ds.field(name).per_clip:
        ids = ", ".join(shown(member.clip.id) for member in item.members)
        raise UsageError(
            f"{name} differs for each dancer of a group", found=shown(clip), fix=f"name one dancer: {ids}"
        )
    lead, rows = ds[item.clip.id].rows_within(name) if item.window is None else (0, ds.read(item.window, name))
    if not len(rows):
        raise UsageError(f"there are no rows of {name}", where=f"clip {shown(clip)}")
    motion = None if columns or name not in scenes.fields else motion_readers(ds)[name].pose(np.asarray(rows)).motion
    if motion is not None:
        shown_rows = _angles_from_mean(motion.rotations)
        labels, edges = motion.skeleton.joints, np.arange(shown_rows.shape[1] + 1)
    else:
        shown_rows = _scaled(np.asarray(rows, dtype=np.float64))
        labels, edges = groups.names, np.cumsum([0, *(g.width for g in groups.groups)])
    n = shown_rows.shape[1]
    height = min(_HIGHEST, _BASE + (_ROW if motion is None else _LABEL) * n)
    axes = axes_or_new(ax, _WIDTH, height)
    begin, end = float(grid.seconds(lead)), float(grid.seconds(lead + len(rows)))
    extent = (begin, end, float(n), 0.0)
    image = axes.imshow(shown_rows.T, aspect="auto", interpolation="nearest", cmap="magma", extent=extent)
    if motion is not None:
        axes.figure.colorbar(image, ax=axes, label="degrees from the mean", pad=0.02, fraction=0.04)
    beats = scenes.scene(item).rhythm.beats
    axes.vlines(beats[beats < end], 0, n, colors="white", linewidths=0.5, alpha=0.6)
    places = _apart((edges[:-1] + edges[1:]) / 2, _LABEL * n / (height - _BASE) if motion is None else 0.0)
    axes.set_yticks(places, [label.replace("_", " ") for label in labels], fontsize="small", parse_math=False)
    axes.set_yticks(edges[1:-1] if motion is None else [], minor=True)
    axes.tick_params(axis="y", which="major", length=0)
    axes.set_xlabel("seconds")
    axes.set_title(f"{shown(clip)}: {name}", loc="left", fontsize="medium", parse_math=False)
    return axes


def _angles_from_mean(rotations: Float64Array) -> Float64Array:
    """Return the angles (T, J), degrees, of axis-angle rotations (T, J, 3) from the mean over T of each joint."""
    matrices = matrix_from_rotvec(rotations)
    u, _, vt = np.linalg.svd(matrices.mean(axis=0))
    u[..., -1] *= np.linalg.det(u @ vt)[:, None]
    traces = np.einsum("jab,tjab->tj", u @ vt, matrices)
    return np.asarray(np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1))))


def _apart(places: Float64Array, gap: float) -> Float64Array:
    """Move places, ascending, so that they are at least `gap` apart; the last one stays."""
    moved = places.copy()
    for k in range(len(moved) - 2, -1, -1):
        moved[k] = min(moved[k], moved[k + 1] - gap)
    return moved


def _scaled(rows: Float64Array) -> Float64Array:
    """Return columns from 0 to 1 between their 2nd and 98th percentiles."""
    low, high = np.percentile(rows, (2, 98), axis=0)
    flat = high <= low
    low, high = np.where(flat, rows.min(axis=0), low), np.where(flat, rows.max(axis=0), high)
    return np.asarray(np.clip((rows - low) / np.where(high > low, high - low, 1.0), 0, 1))

"""pose_map: the poses of a dataset along their two largest components, as in reports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.packages import load
from dancedata.kernel import Store, open_store
from dancedata.plot.dancers import SIDES, axes_or_new, bare
from dancedata.scene.pose_space import Hexagon, base_split, measured_poses

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Height of a pose on the map, in heights of the map, and the least distance of two, in widths of a pose.
_POSE, _APART = 0.14, 1.1
_RINGS = ("#c96a00", "#00866a", "#a8467a", "#6b6f00", "#5a5f69")


def pose_map(store: Store | str | Path, *, stills: int = 14, ax: Axes | None = None) -> Axes:
    """Draw the map of the poses of a dataset, as reports have it.

    Poses of the 22 joints of the body, relative to the root and turned to the front, along their two largest
    principal components.

    Parameters
    ----------
    store
        A built dataset, open or its folder.
    stills
        Most poses that are drawn on the map, spread over it.
    ax
        matplotlib axes to draw on; default: those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Hexagons, the darker the more poses of train; rings: poses of other splits. The axes are the components, with
        their shares of the variance, metres.

    Raises
    ------
    UsageError
        If the dataset has no poses, and where matplotlib is not installed.

    Examples
    --------
    >>> from dancedata import plot
    >>> plot.pose_map("data/demo").figure.savefig("poses.pdf")
    """
    ds = store if isinstance(store, Store) else open_store(store)
    poses = measured_poses(ds)
    if len(poses.hexagons) < 2:
        raise UsageError("there are no poses to map", where=str(ds.path))
    axes = axes_or_new(ax, 6.4, 4.6)
    base, radius = base_split(poses), poses.radius
    counts = np.array([h.counts.get(base, 0) for h in poses.hexagons], dtype=np.float64)
    corners = radius * np.array([(np.sin(k * np.pi / 3), np.cos(k * np.pi / 3)) for k in range(6)])
    centres = np.array([(h.x, h.y) for h in poses.hexagons])
    collection = load("matplotlib.collections", "report", "a figure").PolyCollection
    hexagons = collection(centres[:, None] + corners, cmap="Blues", edgecolors="white", linewidths=0.5)
    hexagons.set_array(np.sqrt(counts))
    hexagons.set_clim(-0.15 * float(np.sqrt(counts.max())), 1.25 * float(np.sqrt(counts.max())))
    axes.add_collection(hexagons)
    for split, colour in zip((s for s in poses.n if s != base), _RINGS, strict=False):
        of_split = np.array([h.counts.get(split, 0) for h in poses.hexagons])
        here = of_split > 0
        if here.any():
            sizes = 6 + 5 * np.minimum(of_split[here], 16) ** 0.5
            ring: dict[str, Any] = {"facecolors": "none", "edgecolors": colour, "linewidths": 0.9}
            axes.scatter(centres[here, 0], centres[here, 1], s=sizes, label=split, zorder=2, **ring)
    low, high = centres.min(axis=0) - 2 * radius, centres.max(axis=0) + 2 * radius
    size = _POSE * float(high[1] - low[1])
    for h in _spread(poses.hexagons, stills, _APART * size):
        _draw_pose(axes, h, poses.joints, size)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    shares = [f"component {k + 1} ({100 * share:.0f} % of the variance), m" for k, share in enumerate(poses.variance)]
    axes.set_xlabel(shares[0])
    axes.set_ylabel(shares[1])
    n = ", ".join(f"{split} {n:,}" for split, n in poses.n.items())
    axes.set_title(f"poses: {n}", loc="left", fontsize="small", parse_math=False)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper right", fontsize="small", frameon=False)
    bare(axes, "top", "right")
    return axes


def _spread(hexagons: tuple[Hexagon, ...], most: int, apart: float) -> list[Hexagon]:
    """Return hexagons that are at least `apart` from each other, those with most poses first."""
    chosen: list[Hexagon] = []
    for h in sorted(hexagons, key=lambda h: (-sum(h.counts.values()), h.x, h.y)):
        if len(chosen) < most and all(np.hypot(h.x - c.x, h.y - c.y) >= apart for c in chosen):
            chosen.append(h)
    return chosen


def _draw_pose(axes: Axes, h: Hexagon, joints: tuple[str, ...], size: float) -> None:
    for side, *places in h.bones(joints):
        ends = np.array(places) / 1000 * (size / 1.7) + (h.x, h.y)
        of_side = SIDES["light"][("mid", "left", "right").index(side)]
        for colour, width in (("white", 3.0), (of_side, 1.3)):
            line: dict[str, Any] = {"color": colour, "linewidth": width, "zorder": 3 + (width < 2)}
            axes.plot(*ends.T, solid_capstyle="round", label="_pose", **line)

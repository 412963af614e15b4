"""paths: roots of dancers seen from above."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.kernel import Store, open_store
from dancedata.plot.dancers import Dancer, axes_or_new, bare, dancers_of, figure_of, scene_of
from dancedata.scene.motion_page import Motions, motion_scenes_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Inches of a square, most squares in a row, and most clips that are drawn without names given.
_INCHES, _COLUMNS, _MOST = 1.5, 6, 12
_PATH, _END = "#2a8ccb", "#a04c00"


def paths(
    source: Store | str | Path | Motions, clips: str | Sequence[str] | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw the paths of roots on the floor, seen from above, all at one scale.

    Parameters
    ----------
    source
        A built dataset, open or its folder; or motions: one, several by name, or a sequence.
    clips
        Ids of clips of the dataset, a square each, moved to begin in its middle; default: the first twelve. One id or
        the name of a group: one square, in which the dancers of a group stand together.
    ax
        matplotlib axes to draw on; default: those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        A square for each clip, +X to the right and +Z, the front of the body at rest, downwards; from the point to
        the ring. The bar is a round number of metres.

    Raises
    ------
    UsageError
        For an unknown clip, and where matplotlib is not installed.

    Examples
    --------
    >>> from dancedata import plot
    >>> plot.paths("data/demo").figure.savefig("paths.pdf")
    """
    squares = _squares(source, clips)
    reach = max(float(np.abs(path).max()) for square in squares.values() for _, path in square) or 1.0
    side = 2.3 * reach
    columns = min(_COLUMNS, len(squares))
    rows = -(-len(squares) // columns)
    scale = _INCHES if len(squares) > 1 else 2.4 * _INCHES
    axes = axes_or_new(ax, scale * columns + 0.2, (scale + 0.25) * rows + 0.3)
    high = side * 1.17  # a name above each square
    for number, (name, square) in enumerate(squares.items()):
        middle = np.array([side * (number % columns), -high * (number // columns)])
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * 0.475 * side + middle
        axes.plot(*corners.T, color="#c7cdd4", linewidth=0.8, label="_square")
        for dancer, path in square:
            places = path * (1, -1) + middle
            colour = _PATH if len(square) == 1 else dancer.sides[0]
            axes.plot(*places.T, color=colour, linewidth=1.2, label=dancer.name or "_path")
            axes.plot(*places[0], "o", color=colour, markersize=4)
            end = _END if len(square) == 1 else colour
            axes.plot(*places[-1], "o", markerfacecolor="none", markersize=6, markeredgecolor=end)
        label = name if len(name) <= 18 else f"{name[:5]}…{name[-12:]}"
        axes.text(middle[0] - 0.475 * side, middle[1] + 0.5 * side, label, fontsize="x-small", parse_math=False)
    _bar(axes, side, -high * (rows - 1) - 0.55 * side)
    if len(squares) == 1 and len(next(iter(squares.values()))) > 1:
        axes.legend(loc="upper right", fontsize="small", frameon=False)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    bare(axes, "top", "right", "bottom", "left")
    return axes


def _squares(
    source: Store | str | Path | Motions, clips: str | Sequence[str] | None
) -> dict[str, list[tuple[Dancer, Float64Array]]]:
    """Return the dancers of each square with their paths (T, 2), metres from its middle."""
    if not isinstance(source, Store | str | Path):
        names = {item.id: item for item in motion_scenes_of(source).items}
        motions = [source] if isinstance(source, Motion) else source.values() if hasattr(source, "values") else source
        return {shown(name): _together([Dancer(figure_of(m))]) for name, m in zip(names, motions, strict=True)}
    store = source if isinstance(source, Store) else open_store(source)
    if isinstance(clips, str):
        return {shown(clips): _together(dancers_of(scene_of(store, clips, None)))}
    names_of = [clip.id for clip in store.clips()[:_MOST]] if clips is None else clips
    if not names_of:
        raise UsageError("there is no path to draw", where=str(store.path))
    squares = {}
    for clip in names_of:
        scene = scene_of(store, clip, None)
        alone = [s.figure for s in scene.dancers if s.item.clip.id == clip and s.figure is not None]
        squares[shown(clip)] = _together([Dancer(figure) for figure in alone] or dancers_of(scene))
    return squares


def _together(dancers: Sequence[Dancer]) -> list[tuple[Dancer, Float64Array]]:
    """Return the paths of dancers in one square: one dancer begins in its middle, several stand around it."""
    roots = [dancer.figure.joints[:, 0][:, [0, 2]] for dancer in dancers]
    every = np.concatenate(roots)
    middle = roots[0][0] if len(roots) == 1 else (every.min(axis=0) + every.max(axis=0)) / 2
    return [(dancer, root - middle) for dancer, root in zip(dancers, roots, strict=True)]


def _bar(axes: Axes, side: float, y: float) -> None:
    """Draw a bar of a round number of metres."""
    length = max(n for n in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if n <= max(side / 2, 0.01))
    left = -0.475 * side
    axes.plot([left, left + length], [y, y], color="#1c2126", linewidth=2, solid_capstyle="butt", label="_bar")
    axes.text(left + length, y, f"  {length:g} m", va="center", fontsize="x-small")

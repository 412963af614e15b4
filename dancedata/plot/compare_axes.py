"""compare: two dances at equal moments, and their distance over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.grid import Number
from dancedata.core.packages import load
from dancedata.core.text import shown
from dancedata.plot.bodies import Camera
from dancedata.plot.dancers import Dance, Dancer, bare, draw_pose, extent, figure_of, moments
from dancedata.plot.motion_axes import places_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

#: Inches of a metre, and of the curve with the labels.
_INCHES, _CURVE = 1.05, 1.9
#: Metres from one row of poses to the other.
_ROW = 2.15


def compare(
    a: Dance,
    b: Dance,
    *,
    names: tuple[str, str] = ("a", "b"),
    poses: int = 7,
    times: Sequence[float] | None = None,
    fps: Number | None = None,
    body: str | None = None,
    turn_deg: float = 25.0,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw two dances: stills at equal moments, one row each, and the distance of their joints below.

    Parameters
    ----------
    a, b
        Motions, clips of datasets (``ds[ID]``), or joint positions (T, J, 3), metres, of any rate and length.
    names
        What they are called.
    poses
        Number of stills, evenly spaced over the time of both.
    times
        Seconds of the stills instead, ascending.
    fps, body
        Rate and body of joint positions; see `dancedata.evaluate`.
    turn_deg
        The camera's turn about the vertical axis from the front, +Z, degrees.
    figure
        matplotlib figure or part of one to draw on; default: a new one.

    Returns
    -------
    matplotlib.figure.Figure
        Its axes: stills, and the distance: mean over the joints that both have by name, in the world, centimetres, at
        each frame of `a`. Lines mark the moments of the stills.

    Raises
    ------
    UsageError
        If a dance cannot be read, both have no joint or no time in common, or a time is outside of them.

    Examples
    --------
    >>> import dancedata
    >>> from dancedata import plot
    >>> ds = dancedata.open("data/demo")
    >>> plot.compare(ds.clips()[0], ds.clips()[1], names=("truth", "mine")).savefig("compare.pdf")
    """
    figures = figure_of(a, fps, body), figure_of(b, fps, body)
    distance = figures[0].distance_mm(figures[1]) / 10
    both = int(np.isfinite(distance).sum())
    if not both:
        raise UsageError("the dances have no joints by the same names", found=", ".join(map(repr, figures)))
    first = figures[0].part(0.0, both / float(figures[0].grid.rate))
    frames = moments(first, poses, times)
    at_s = [at / float(first.grid.rate) for at in frames]
    rate = float(figures[1].grid.rate)
    rows = (frames, [min(round(at * rate), figures[1].n_frames - 1) for at in at_s])
    cameras = [
        [Camera(f.joints[at, 0] * (1, 0, 1) + (0, f.floor, 0), turn_deg) for at in row]
        for f, row in zip(figures, rows, strict=True)
    ]
    reach = np.array(
        [[extent(f, at, camera) for at, camera in zip(row, of, strict=True)]
         for f, row, of in zip(figures, rows, cameras, strict=True)]
    )  # fmt: skip
    places, width = places_of([(float(r[:, 0].min()), float(r[:, 1].max())) for r in reach.transpose(1, 0, 2)])
    size = (_INCHES * width + 0.9, _INCHES * (2 * _ROW + 0.2) + _CURVE)
    drawn = figure or load("matplotlib.figure", "report", "a figure").Figure(figsize=size, layout="constrained")
    stills, curve = drawn.subplots(2, 1, height_ratios=(size[1] - _CURVE, _CURVE))
    for dance, row, of, floor in zip(figures, rows, cameras, (_ROW, 0.0), strict=True):
        stills.axhline(floor, color="#9aa4b1", linewidth=0.8, zorder=0)
        for place, at, camera in zip(places, row, of, strict=True):
            draw_pose(stills, Dancer(dance), at, camera, (place, floor), as_body=True)
    stills.set_aspect("equal")
    stills.set_xticks(places, [f"{at:.2f} s" for at in at_s])
    stills.set_yticks([_ROW + 0.9, 0.9], [shown(name, 30) for name in names], parse_math=False)
    stills.tick_params(length=0)
    bare(stills, "top", "right", "bottom", "left")
    curve.plot(np.arange(both) / float(first.grid.rate), distance[:both], color="#1c2126", linewidth=1.3)
    curve.vlines(at_s, 0, 1, transform=curve.get_xaxis_transform(), color="#9aa4b1", linewidth=0.8, linestyle=":")
    curve.set_xlim(0, max(both - 1, 1) / float(first.grid.rate))
    curve.set_ylim(bottom=0)
    curve.set_xlabel("seconds")
    curve.set_ylabel("distance, cm")
    mean = float(distance[:both].mean())
    curve.set_title(f"mean {mean:.1f} cm", loc="right", fontsize="small")
    bare(curve, "top", "right")
    return drawn

"""motion: poses of a dance side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.text import shown
from dancedata.kernel import Store
from dancedata.plot.bodies import Camera
from dancedata.plot.dancers import Dancer, axes_or_new, bare, dancers_of, draw_pose, extent, moments, scene_of
from dancedata.scene.figure import Figure
from dancedata.scene.scene_list import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Metres between two bodies, and inches of a metre.
_GAP, _INCHES = 0.2, 1.15
#: Least width of a pose, metres: room for its time.
_LEAST = 0.62
#: Height of a raised hand above the floor.
_TALL = 2.1


def motion(
    source: Motion | Store | str | Path,
    clip: str | None = None,
    *,
    field: str | None = None,
    poses: int = 8,
    times: Sequence[float] | Literal["beats"] | None = None,
    turn_deg: float = 25.0,
    body: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw poses of a dance side by side, at their times; of a group all dancers, as they stand together.

    Parameters
    ----------
    source
        A motion, or a built dataset, open or its folder.
    clip
        Id of a clip of the dataset, or name of a group.
    field
        Motion field of the dataset; default: the best one to draw.
    poses
        Number of poses, evenly spaced over the clip.
    times
        Seconds of the poses instead, ascending; "beats": poses at up to `poses` beats, evenly chosen.
    turn_deg
        The camera's turn about the vertical axis from the front, +Z, degrees.
    body
        Whether bones have the girth of a body; if not, they are lines.
    ax
        matplotlib axes to draw on; default: those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Metres above the floor upwards, and equal gaps between the bodies; left limbs are blue, right ones orange,
        feet in contact ringed. The dancers of a group have a colour each, left limbs lighter than right ones, and a
        legend.

    Raises
    ------
    UsageError
        For an unknown clip or field, a time outside of the motion, "beats" where there are none, and where matplotlib
        is not installed.

    Examples
    --------
    >>> from dancedata import plot
    >>> plot.motion("data/demo", "gBR_sBM_cAll_d04_mBR4_ch03", poses=6, times="beats").figure.savefig("poses.pdf")
    """
    scene = None
    if isinstance(source, Motion):
        dancers = [Dancer(Figure.of_joints(source.joints(), source.skeleton, source.grid))]
    else:
        scene = scene_of(source, clip, field)
        dancers = dancers_of(scene)
    figure = dancers[0].figure
    frames = moments(figure, poses, _at_beats(scene, figure, poses) if isinstance(times, str) else times)
    roots = np.stack([[dancer.figure.joints[at, 0] for dancer in dancers] for at in frames])
    middles = (roots.min(axis=1) + roots.max(axis=1)) / 2
    middles[:, 1] = min(dancer.figure.floor for dancer in dancers)
    cameras = [Camera(middle, turn_deg) for middle in middles]
    reach = [
        np.array([extent(dancer.figure, at, camera) for dancer in dancers])
        for at, camera in zip(frames, cameras, strict=True)
    ]
    places, width = places_of([(float(r[:, 0].min()), float(r[:, 1].max())) for r in reach])
    axes = axes_or_new(ax, _INCHES * (width + 0.6), _INCHES * (_TALL + 0.7))
    for place, at, camera in zip(places, frames, cameras, strict=True):
        for dancer in dancers:
            draw_pose(axes, dancer, at, camera, (place, 0.0), as_body=body)
    if len(dancers) > 1:
        names = [dancer.name for dancer in dancers]
        handles = [axes.plot([], [], color=dancer.sides[0], linewidth=2.4)[0] for dancer in dancers]
        at_the_top = {"bbox_to_anchor": (1, 1), "borderaxespad": 0, "ncols": len(dancers)}
        axes.legend(handles, names, loc="lower right", fontsize="small", frameon=False, **at_the_top)
    axes.axhline(0, color="#9aa4b1", linewidth=0.8, zorder=0)
    axes.set_xticks(places, [f"{at / float(figure.grid.rate):.2f} s" for at in frames])
    axes.set_ylabel("metres")
    axes.set_aspect("equal")
    bare(axes, "top", "right", "bottom")
    axes.tick_params(axis="x", length=0)
    axes.set_title("" if scene is None else shown(scene.item.name), loc="left", fontsize="medium", parse_math=False)
    return axes


def places_of(reaches: Sequence[tuple[float, float]]) -> tuple[list[float], float]:
    """Return places side by side with equal gaps, the first at 0, and the whole width, metres."""
    places: list[float] = []
    right = 0.0
    for left, end in reaches:
        spare = max(0.0, _LEAST - _GAP - (end - left)) / 2
        place = right + _GAP - left + spare if places else 0.0
        places.append(place)
        right = place + end + spare
    return places, right - reaches[0][0]


def _at_beats(scene: Scene | None, figure: Figure, poses: int) -> list[float]:
    beats = np.zeros(0) if scene is None else scene.rhythm.beats
    beats = beats[beats <= float(figure.grid.seconds(figure.n_frames - 1))]
    if not len(beats):
        fix = "draw a clip of a dataset with music, or give times= in seconds"
        raise UsageError("there are no beats to draw poses at", fix=fix)
    chosen = np.linspace(0, len(beats) - 1, max(1, min(poses, len(beats)))).round().astype(int)
    return [float(beat) for beat in beats[chosen]]

"""Figures for papers: features of a clip over time, and poses of a dance side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.packages import load
from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.store import Store, open_store
from dancedata.viewer import Figure, Scenes
from dancedata.viewer.palette import colours_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


#: Inches: width, height without rows, and height of a row; greatest height.
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
        Time in seconds to the right; a line per column, the first at the top, each scaled by its 2nd and 98th
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
    if item.members and ds.field(name).per_clip:
        ids = ", ".join(shown(member.clip.id) for member in item.members)
        raise UsageError(f"each dancer of a group has rows of {name}", found=shown(clip), fix=f"name one: {ids}")
    lead, rows = ds.rows_within(item.clip.id, name) if item.window is None else (0, ds.read(item.window, name))
    if not len(rows):
        raise UsageError(f"there are no rows of {name}", where=f"clip {shown(clip)}")
    height = min(_HIGHEST, _BASE + _ROW * columns.width)
    axes = axes_or_new(ax, _WIDTH, height)
    begin, end = float(grid.seconds(lead)), float(grid.seconds(lead + len(rows)))
    axes.imshow(
        _scaled(np.asarray(rows, dtype=np.float64)).T,
        aspect="auto",
        interpolation="nearest",
        cmap="magma",
        extent=(begin, end, columns.width, 0.0),
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
    """Return columns from 0 to 1 between their 2nd and 98th percentiles."""
    low, high = np.percentile(rows, (2, 98), axis=0)
    flat = high <= low
    low, high = np.where(flat, rows.min(axis=0), low), np.where(flat, rows.max(axis=0), high)
    return np.asarray(np.clip((rows - low) / np.where(high > low, high - low, 1.0), 0, 1))


def axes_or_new(axes: Axes | None, width: float, height: float) -> Axes:
    """Return the given axes, or those of a new figure of this size in inches; no window is opened."""
    if axes is not None:
        return axes
    figure = load("matplotlib.figure", "report", "a figure").Figure(figsize=(width, height), layout="constrained")
    new_axes: Axes = figure.subplots()
    return new_axes


#: Colours of the middle, the left and the right of a body: distinguishable with every kind of colour vision.
_SIDES = ("#4a525c", "#2a8ccb", "#a04c00")
#: Metres between two poses, and inches of a metre.
_SPACING, _INCHES = 1.1, 1.15
#: Height of a raised hand above the floor.
_TALL = 2.1


def motion(
    source: Motion | Store | str | Path,
    clip: str | None = None,
    *,
    field: str | None = None,
    frame: int = 0,
    poses: int = 8,
    times: Sequence[float] | None = None,
    turn_deg: float = 25.0,
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
    frame
        In window scope, the first frame of the window.
    poses
        Number of poses, evenly spaced over the clip.
    times
        Seconds of the poses instead, ascending.
    turn_deg
        The camera's turn about the vertical axis from the front, +Z, degrees.
    ax
        matplotlib axes to draw on; default: those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Metres above the floor upwards; left limbs are blue, right ones orange, feet in contact ringed. The dancers of
        a group have a colour each, left limbs lighter than right ones, and a legend.

    Raises
    ------
    UsageError
        For an unknown clip or field, a time outside of the motion, and where matplotlib is not installed.

    Examples
    --------
    >>> from dancedata import plot
    >>> plot.motion("data/demo", "gBR_sBM_cAll_d04_mBR4_ch03", poses=6).figure.savefig("poses.pdf")
    """
    dancers, title = _dancers(source, clip, field, frame)
    figure = dancers[0].figure
    frames = _frames(figure, poses, times)
    roots = np.stack([[dancer.figure.joints[at, 0] for dancer in dancers] for at in frames])
    middles = (roots.min(axis=1) + roots.max(axis=1)) / 2
    across = np.stack(
        [_seen(of_frame, middle, turn_deg)[:, 0] for of_frame, middle in zip(roots, middles, strict=True)]
    )
    spacing = _SPACING + float(np.ptp(across, axis=1).max())
    floor = min(dancer.figure.floor for dancer in dancers)
    axes = axes_or_new(ax, _INCHES * (spacing * len(frames) + 0.6), _INCHES * (_TALL + 0.7))
    for place, (at, middle) in enumerate(zip(frames, middles, strict=True)):
        for dancer in dancers:
            joints = _seen(dancer.figure.joints[at], middle, turn_deg) + np.array([spacing * place, -floor])
            _draw(axes, dancer, joints, dancer.figure.contacts[at])
    if len(dancers) > 1:
        names = [dancer.name for dancer in dancers]
        handles = [axes.plot([], [], color=dancer.sides[0], linewidth=2.4)[0] for dancer in dancers]
        at_the_top = {"bbox_to_anchor": (1, 1), "borderaxespad": 0, "ncols": len(dancers)}
        axes.legend(handles, names, loc="lower right", fontsize="small", frameon=False, **at_the_top)
    axes.axhline(0, color="#9aa4b1", linewidth=0.8, zorder=0)
    labels = [f"{at / float(figure.grid.rate):.2f} s" for at in frames]
    axes.set_xticks([spacing * k for k in range(len(frames))], labels)
    axes.set_ylabel("metres")
    axes.set_aspect("equal")
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="x", length=0)
    axes.set_title(title, loc="left", fontsize="medium", parse_math=False)
    return axes


class _Dancer(NamedTuple):
    """A figure, the colours of its middle, left and right, and its name among others."""

    figure: Figure
    sides: tuple[str, str, str] = _SIDES
    name: str = ""


def _dancers(
    source: Motion | Store | str | Path, clip: str | None, field: str | None, frame: int
) -> tuple[list[_Dancer], str]:
    if isinstance(source, Motion):
        return [_Dancer(Figure.of_joints(source.joints(), source.skeleton, source.grid))], ""
    store = source if isinstance(source, Store) else open_store(source)
    if clip is None:
        raise UsageError("a dataset has many clips", where=str(store.path), fix="name the clip: motion(store, CLIP)")
    scenes = Scenes(store, field)
    scene = scenes.scene(scenes.find(clip, frame))
    figures = [(dancer.figure, dancer.item) for dancer in scene.dancers if dancer.figure is not None]
    if not figures:
        raise UsageError("no field of this dataset can be drawn", where=str(store.path), found="; ".join(scene.notes))
    if not scene.members:
        return [_Dancer(figures[0][0])], shown(clip)
    return [_Dancer(f, colours_of(item, "light"), shown(item.part, 20)) for f, item in figures], shown(clip)


def _frames(figure: Figure, poses: int, times: Sequence[float] | None) -> list[int]:
    if times is None:
        if poses < 1:
            raise UsageError("there is no pose to draw", found=f"poses={poses}", allowed="at least 1")
        evenly = np.linspace(0, figure.n_frames - 1, min(poses, figure.n_frames))
        return [round(at) for at in evenly.tolist()]
    frames = [round(time * float(figure.grid.rate)) for time in times]
    if not frames or min(frames) < 0 or max(frames) >= figure.n_frames:
        end = float(figure.grid.seconds(figure.n_frames - 1))
        raise UsageError(
            "a time is not within the motion", found=shown(list(times)), allowed=f"seconds from 0 to {end:.3f}"
        )
    return frames


def _seen(joints: Float64Array, middle: Float64Array, turn_deg: float) -> Float64Array:
    """Return joints (J, 3) from the camera's side, (J, 2): `middle` at 0 to the right, height upwards."""
    angle = np.radians(turn_deg)
    away = joints - middle
    return np.stack([away[:, 0] * np.cos(angle) - away[:, 2] * np.sin(angle), joints[:, 1]], axis=1)


def _draw(
    axes: Axes, dancer: _Dancer, points: Float64Array, contacts: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> None:
    figure = dancer.figure
    for parent, joint in figure.bones:
        colour = dancer.sides[figure.sides[joint]]
        axes.plot(*points[[parent, joint]].T, color=colour, linewidth=2.4, solid_capstyle="round")
    for touches, joint in zip(contacts, figure.contact_joints, strict=True):
        if touches:
            axes.plot(*points[joint], marker="o", markersize=7, markerfacecolor="none", markeredgecolor="#00866a")
    if "head" in figure.skeleton.joints:
        head = points[figure.skeleton.joints.index("head")]
        axes.plot(*head, marker="o", markersize=9, color=dancer.sides[0])

"""Dancers of figures: what they are read from, and their bodies as polygons on axes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.packages import load
from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.kernel import Store, open_store
from dancedata.plot.bodies import Camera, body
from dancedata.scene.figure import Figure
from dancedata.scene.palette import Theme, colours_of
from dancedata.scene.scene_list import Scene
from dancedata.scene.scenes import Scenes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Colours of the middle, the left and the right of a body: distinguishable with every kind of colour vision.
SIDES: dict[Theme, tuple[str, str, str]] = {
    "light": ("#4a525c", "#2a8ccb", "#a04c00"), "dark": ("#d5d9df", "#7accf8", "#d48500")
}  # fmt: skip
_CONTACT = "#00866a"


class Dancer(NamedTuple):
    """A figure, the colours of its middle, left and right, and its name among others."""

    figure: Figure
    sides: tuple[str, str, str] = SIDES["light"]
    name: str = ""


def scene_of(source: Store | str | Path, clip: str | None, field: str | None) -> Scene:
    """Return the scene of a clip or group; UsageError if it is unknown, or no field of it can be drawn."""
    store = source if isinstance(source, Store) else open_store(source)
    if clip is None:
        raise UsageError("a dataset has many clips", where=str(store.path), fix="name the clip: motion(store, CLIP)")
    scenes = Scenes(store, field)
    scene = scenes.scene(scenes.find(clip))
    if not scene.dancers:
        raise UsageError("no field of this dataset can be drawn", where=str(store.path), found="; ".join(scene.notes))
    return scene


def dancers_of(scene: Scene, theme: Theme = "light") -> list[Dancer]:
    """Return the dancers of a scene, those of a group in a colour each."""
    figures = [(dancer.figure, dancer.item) for dancer in scene.dancers if dancer.figure is not None]
    if not scene.members:
        return [Dancer(figures[0][0], SIDES[theme])]
    return [Dancer(figure, colours_of(item, theme), shown(item.part, 20)) for figure, item in figures]


def extent(figure: Figure, at: int, camera: Camera) -> tuple[float, float]:
    """Return how far a body reaches to the left and to the right of the camera's middle, metres."""
    across = camera(figure.joints[at])[:, 0]
    girth = float(np.max(figure.limbs.girths))
    return float(across.min()) - girth, float(across.max()) + girth


def draw_pose(
    axes: Axes, dancer: Dancer, at: int, camera: Camera, place: tuple[float, float], *, as_body: bool
) -> None:
    """Draw a pose with the camera's middle at a place (right, up), as body or sticks; feet in contact are ringed."""
    figure = dancer.figure
    points = camera(figure.joints[at])[:, :2] + place
    if as_body:
        axes.add_collection(body(figure, at, camera, dancer.sides, place, zorder=2))
        axes.autoscale_view()
    else:
        _draw_sticks(axes, dancer, points)
    for touches, joint in zip(figure.contacts[at], figure.contact_joints, strict=True):
        if touches:
            axes.plot(*points[joint], marker="o", markersize=7, markerfacecolor="none", markeredgecolor=_CONTACT)


def _draw_sticks(axes: Axes, dancer: Dancer, points: Float64Array) -> None:
    figure = dancer.figure
    for parent, joint in figure.bones:
        colour = dancer.sides[figure.sides[joint]]
        axes.plot(*points[[parent, joint]].T, color=colour, linewidth=2.4, solid_capstyle="round")
    if "head" in figure.skeleton.joints:
        head = points[figure.skeleton.joints.index("head")]
        axes.plot(*head, marker="o", markersize=9, color=dancer.sides[0])


def moments(figure: Figure, poses: int, times: Sequence[float] | None = None) -> list[int]:
    """Return the frames of times, seconds, or of poses evenly spaced; UsageError if they are not there."""
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


def axes_or_new(axes: Axes | None, width: float, height: float) -> Axes:
    """Return the given axes, or those of a new figure of this size in inches; no window is opened."""
    if axes is not None:
        return axes
    figure = load("matplotlib.figure", "report", "a figure").Figure(figsize=(width, height), layout="constrained")
    new_axes: Axes = figure.subplots()
    return new_axes


def bare(axes: Axes, *sides: str) -> None:
    """Hide sides of the frame of axes."""
    for side in sides:
        axes.spines[side].set_visible(False)

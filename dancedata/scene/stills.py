"""Stills: a pose that faces the reader, drawn as the viewer's body, for pages and notebooks."""

import html

import numpy as np

from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import shown
from dancedata.scene.figure import Figure
from dancedata.scene.limbs import Limbs, chest_looks
from dancedata.scene.pose_space import frontal

#: Size of a still, and its margin, in units of the drawing.
_WIDTH, _HEIGHT, _MARGIN = 90.0, 120.0, 4.0
#: Colours of the trunk, left and right limbs and the face, at the edge and lit; readable on light and dark pages.
_TONES = (("#596169", "#8b959f"), ("#176ca5", "#2f9ce8"), ("#944f00", "#d07a12"), ("#30363c", "#454d55"))
_FACE = 3
#: For the edge and the lit part: share of the width, and shift towards the light, up and to the right, in radii.
_PARTS = ((1.0, 0.0), (0.7, 0.16))


def middle_still(figure: Figure, label: str, height: float = _HEIGHT) -> str:
    """Return the pose in the middle of a figure, turned so that its hips face the reader."""
    middle = figure.n_frames // 2
    pose = frontal(figure.joints[middle : middle + 1], figure.skeleton.joints)[0]
    return still(pose, figure.skeleton, label, height)


def still(pose: Float64Array, skeleton: Skeleton, label: str, height: float = _HEIGHT) -> str:
    """Return a pose (J, 3) that faces the front as an SVG image of `height`; the body's left is on its right."""
    look = chest_looks(pose[None], skeleton)
    cones = Limbs.of(pose, skeleton).cones(pose, None if look is None else look[0])
    ends = np.stack([cones.begin, cones.end], axis=1)
    low, high = (ends[..., :2] - cones.radii[..., None]), (ends[..., :2] + cones.radii[..., None])
    low, high = low.min(axis=(0, 1)), high.max(axis=(0, 1))
    scale = float(np.min((np.array([_WIDTH, _HEIGHT]) - 2 * _MARGIN) / np.maximum(high - low, 0.1)))
    places = np.array([_WIDTH, _HEIGHT]) / 2 + (ends[..., :2] - (low + high) / 2) * scale * [1, -1]
    ways = []
    # Fingers would be thinner than a point.
    kept = (cones.radii.max(axis=1) * scale > 1) | (np.array(cones.tones) == _FACE)
    for k in np.argsort(ends[..., 2].sum(axis=1).round(6), kind="stable"):
        if not kept[k]:
            continue
        for (share, shift), colour in zip(_PARTS, _TONES[cones.tones[k]], strict=True):
            radii = cones.radii[k] * scale
            lit = places[k] + radii[:, None] * shift * np.array([0.55, -0.83])
            ways.append(f'<path fill="{colour}" d="{_hull(lit, radii * share)}"/>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" height="{height:g}" '
        f'role="img" aria-label="{html.escape(shown(label, 200))}">{"".join(ways)}</svg>'
    )


def _hull(places: Float64Array, radii: Float64Array) -> str:
    """Return the SVG path around two circles, (2, 2) and (2,), and the tangents between them."""
    across, down = places[1] - places[0]
    distance = float(np.hypot(across, down))
    turn = np.arctan2(down, across)
    opening = np.arccos(np.clip((radii[0] - radii[1]) / max(distance, 1e-9), -1, 1))
    way = ""
    for k, (begin, end) in enumerate([(opening, -opening), (-opening, opening)]):
        (x, y), (to_x, to_y) = (
            places[k] + radii[k] * np.array([np.cos(a), np.sin(a)]) for a in (turn + begin, turn + end)
        )
        is_large = (opening < np.pi / 2) == (k == 0)
        way += f"{'LM'[not k]}{x:.1f} {y:.1f}A{radii[k]:.1f} {radii[k]:.1f} 0 {is_large:d} 1 {to_x:.1f} {to_y:.1f}"
    return way

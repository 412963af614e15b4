"""Stills: poses that face the reader."""

from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton
from dancedata.pages.svg import drawn

#: Size of a still, units of the page's text.
_WIDTH, _HEIGHT, _MARGIN = 90.0, 120.0, 6.0


def still(pose: Float64Array, skeleton: Skeleton, label: str) -> str:
    """Return a pose (J, 3) that faces the front as an SVG image: bones as lines, left and right in their colours."""
    low, high = pose[:, :2].min(axis=0), pose[:, :2].max(axis=0)
    scale = min(
        (_WIDTH - 2 * _MARGIN) / max(high[0] - low[0], 0.1), (_HEIGHT - 2 * _MARGIN) / max(high[1] - low[1], 0.1)
    )
    middle = (low + high) / 2
    # The dancer faces the reader: the left side is on the right of the picture.
    places = [(_WIDTH / 2 + (x - middle[0]) * scale, _HEIGHT / 2 - (y - middle[1]) * scale) for x, y in pose[:, :2]]
    ways: dict[str, str] = {}
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            side = skeleton.joints[j].split("_")[0]
            kind = side if side in ("left", "right") else "mid"
            (x, y), (to_x, to_y) = places[parent], places[j]
            ways[kind] = ways.get(kind, "") + f"M{x:.1f} {y:.1f}L{to_x:.1f} {to_y:.1f}"
    body = "".join(f'<path class="bone {kind}" d="{way}"/>' for kind, way in ways.items())
    return drawn(body, label, _HEIGHT, _WIDTH, "still")

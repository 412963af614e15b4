"""The figures of the stage: left and right, where dancers face over time, and where they stand."""

from collections.abc import Callable, Sequence

import numpy as np

from dancedata.core.rotations import Float64Array
from dancedata.pages.figures import FigureSpec
from dancedata.pages.markup import Figure, escaped, number, rounded
from dancedata.pages.stage import FACING_DEG, StageNumbers
from dancedata.pages.svg import drawn, ticks

#: Steps of darkness of the maps.
_SHADES = 8
#: Half the room of the bars, the row of one, and the place of the names, units of the page's text.
_ROOM, _ROW, _MIDDLE = 118.0, 19, 232.0
#: Size of the maps, and their margin on the left.
_WIDE, _HIGH, _LEFT = 350.0, 210.0, 58.0


def stage_figures(d: FigureSpec) -> list[Figure]:
    """Return the balance of left and right, facing over time, and the floor that is covered; without empty ones."""
    stage = d.numbers.movement.stage
    figures = [_balance(stage)] if stage.balance else []
    if stage.facing:
        figures.append(_facing(stage))
    if stage.floor:
        figures.append(_floor(stage))
    return figures


def _balance(stage: StageNumbers) -> Figure:
    most = max([*(b.left_m_s for b in stage.balance.values()), *(b.right_m_s for b in stage.balance.values())]) or 1.0
    body = ""
    for row, (name, pair) in enumerate(stage.balance.items()):
        y = 4 + row * _ROW
        body += f'<text x="{_MIDDLE - _ROOM - 42:.0f}" y="{y + 11}" text-anchor="end">{escaped(name)}</text>'
        for side, value, sign in (("left", pair.left_m_s, -1), ("right", pair.right_m_s, 1)):
            width = value / most * _ROOM
            x = _MIDDLE - width if sign < 0 else _MIDDLE
            title = f"<title>{side} {escaped(name)}: {number(value)} m/s</title>"
            body += f'<rect class="{side}" x="{x:.1f}" y="{y}" width="{width:.1f}" height="13">{title}</rect>'
            anchor, place = ("end", x - 5) if sign < 0 else ("start", x + width + 5)
            body += f'<text x="{place:.1f}" y="{y + 11}" text-anchor="{anchor}" class="value">{rounded(value)}</text>'
    rows = tuple((name, b.left_m_s, b.right_m_s, b.left_share) for name, b in stage.balance.items())
    note = "mean speed of each joint, m/s; left of the dancer in blue. A choreography has both sides about equal"
    image = drawn(body, "speed of left and right joints", 8 + _ROW * len(stage.balance))
    return Figure("balance", "Left and right", note, image, ("joint", "left m/s", "right m/s", "left / both"), rows)


def _facing(stage: StageNumbers) -> Figure:
    counts = np.array(stage.facing, dtype=np.float64)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    n, directions = counts.shape
    wide, high = _WIDE / n, _HIGH / directions
    # The largest direction at the top.
    body = _cells(shares, lambda k, j: (_LEFT + k * wide, 4 + _HIGH - (j + 1) * high), wide, high)
    for angle in (-180, -90, 0, 90, 180):
        y = 4 + _HIGH * (0.5 - angle / 360)
        body += f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{number(angle)}°</text>'
    end = n * stage.every_s
    body += _axis([(_LEFT + t / end * _WIDE, t) for t in ticks(0, end, 7)], "seconds from the beginning of the clip")
    front = float(counts[:, [directions // 2 - 2, directions // 2 - 1, directions // 2, directions // 2 + 1]].sum())
    share = 100 * front / max(float(counts.sum()), 1.0)
    note = (
        f"direction of the hips, 0° is +Z and 90° is +X; share of the dancers at each time; {share:.0f}\xa0% of all "
        f"frames within {2 * FACING_DEG}° of +Z"
    )
    edges = [FACING_DEG * j - 180 for j in range(directions)]
    rows = tuple((k * stage.every_s, *row) for k, row in enumerate(stage.facing))
    head = ("from s", *(f"{edge}°" for edge in edges))
    return Figure("facing", "Where dancers face", note, drawn(body, "facing over time", _HIGH + 46), head, rows)


def _floor(stage: StageNumbers) -> Figure:
    counts = np.array(stage.floor, dtype=np.float64)
    (nx, nz), (x0, z0), side = counts.shape, stage.first_m, stage.square_m
    cell = min(_WIDE / nx, 300.0 / nz)
    high = cell * nz
    body = _cells(np.sqrt(counts), lambda k, j: (_LEFT + k * cell, 4 + j * cell), cell, cell)
    for z in ticks(z0, z0 + nz * side, 6):
        y = 4 + (z - z0) / side * cell
        body += f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{number(z)}</text>'
    places = [(_LEFT + (x - x0) / side * cell, x) for x in ticks(x0, x0 + nx * side, 6)]
    body += _axis(places, "x, metres; z downwards: the front is below", high)
    used = int((counts > 0).sum()) * side**2
    note = f"roots seen from above, squares of {number(side)} m, darker: more frames; {rounded(used)} m² are used"
    if stage.beyond:
        note += f"; {stage.beyond:,} frames farther than 20 m from the origin are left out"
    rows = tuple(
        (round(x0 + k * side, 3), round(z0 + j * side, 3), int(counts[k, j])) for k, j in np.argwhere(counts).tolist()
    )
    return Figure("stage", "Where dancers stand", note, drawn(body, "coverage of the floor", high + 46),
                  ("x m", "z m", "frames"), rows)  # fmt: skip


def _axis(places: Sequence[tuple[float, float]], label: str, high: float = _HIGH) -> str:
    texts = "".join(
        f'<text x="{x:.1f}" y="{high + 20:.1f}" text-anchor="middle">{number(value)}</text>' for x, value in places
    )
    return (
        f'{texts}<text x="{_LEFT + _WIDE / 2}" y="{high + 38:.1f}" text-anchor="middle" class="label">{label}</text>'
    )


def _cells(values: Float64Array, place: Callable[[int, int], tuple[float, float]], wide: float, high: float) -> str:
    """Return the cells of a map, one path for each step of darkness; empty cells are not drawn."""
    most = float(values.max()) or 1.0
    ways: dict[int, str] = {}
    for k, j in np.argwhere(values > 0).tolist():
        x, y = place(k, j)
        shade = max(1, round(values[k, j] / most * _SHADES))
        ways[shade] = ways.get(shade, "") + f"M{x:.1f} {y:.1f}h{wide - 0.6:.1f}v{high - 0.6:.1f}h{0.6 - wide:.1f}z"
    return "".join(
        f'<path class="s0" fill-opacity="{shade / _SHADES:.3f}" d="{way}"/>' for shade, way in sorted(ways.items())
    )

"""The figures of poses and splits: the map of poses, how far splits lie from train, windows that they share."""

from collections.abc import Sequence
from math import cos, pi, sin

from dancedata.pages.figures import FigureSpec
from dancedata.pages.markup import Figure, Markup, escaped, rounded, scrolled, table
from dancedata.pages.svg import drawn
from dancedata.scene.pose_space import DRAWS, DUPLICATE_M, Hexagon, Nearness, Poses, base_split

#: Size of the map, of the pose beside it, and the margin, units of the page's text.
_MAP, _SIDE, _EDGE = (620.0, 420.0), 190.0, 16.0
#: Pairs of windows in the list.
_PAIRS = 40
_FEATURES = {"kinetic": "FID_k", "geometric": "FID_g"}


def pose_figures(d: FigureSpec) -> list[Figure]:
    """Return the map of poses, with the distances of the splits below it."""
    poses = d.numbers.poses
    if len(poses.hexagons) < 2:
        return []
    shares = " and ".join(f"{100 * share:.0f} %" for share in poses.variance[:2])
    note = (
        f"{sum(poses.n.values()):,} poses of {len(poses.joints)} joints, from the root and turned to the front, "
        f"along their two largest components ({shares} of the variance); darker: more poses of {base_split(poses)}; "
        "rings: other splits; beside the map the pose nearest to a hexagon's centre, which a click plays"
    )
    return [Figure("poses", "Map of the poses", note, _pose_map(d, poses), kind="wide")]


def split_space_figures(d: FigureSpec) -> list[Figure]:
    """Return the distances of other splits from train, and the windows that two splits share."""
    figures = [_nearness(d.numbers.poses), _frechet(d.numbers.poses), _duplicates(d)]
    return [figure for figure in figures if figure is not None]


def _pose_map(d: FigureSpec, poses: Poses) -> str:
    xs, ys = [h.x for h in poses.hexagons], [h.y for h in poses.hexagons]
    (width, height), r, base = _MAP, poses.radius, base_split(poses)
    scale = min((width - 2 * _EDGE) / (max(xs) - min(xs) + 2 * r), (height - 2 * _EDGE) / (max(ys) - min(ys) + 2 * r))

    wide = 2 * _EDGE + (max(xs) - min(xs) + 2 * r) * scale

    def place(h: Hexagon) -> tuple[float, float]:
        return _EDGE + (h.x - min(xs) + r) * scale, height - _EDGE - (h.y - min(ys) + r) * scale

    most = max(h.counts.get(base, 0) for h in poses.hexagons) or 1
    corners = [(r * scale * sin(k * pi / 3), r * scale * cos(k * pi / 3)) for k in range(6)]
    others = [split for split in poses.n if split != base]
    cells, shown = "", max(poses.hexagons, key=lambda h: h.counts.get(base, 0))
    for h in poses.hexagons:
        x, y = place(h)
        way = "L".join(f"{x + dx:.1f} {y + dy:.1f}" for dx, dy in corners)
        share = h.counts.get(base, 0) / most
        opacity = f"{0.12 + 0.88 * share**0.5:.2f}" if share else "0"
        counts = ", ".join(f"{split} {n}" for split, n in h.counts.items())
        body = f'<path class="hex s0" fill-opacity="{opacity}" d="M{way}z"/>'
        for k, split in enumerate(others):
            if h.counts.get(split):
                radius = min(0.8, 0.2 + 0.1 * h.counts[split] ** 0.5) * r * scale
                body += f'<circle class="ring s{k + 1}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"/>'
        title = f"<title>{escaped(f'{h.clip}, {h.seconds:.1f} s; {counts}')}</title>"
        kind = "cell most" if h is shown else "cell"
        cells += f'<g class="{kind}">{_linked(d, h, body + title)}{_pose(h, poses.joints, wide)}</g>'
    legend = "".join(f'<span><i class="s{k}"></i>{escaped(split)}</span>' for k, split in enumerate([base, *others]))
    image = drawn(cells, "map of the poses", height, round(wide + _SIDE), "posemap")
    return f'<p class="legend">{legend}</p>{image}'


def _linked(d: FigureSpec, h: Hexagon, body: str) -> str:
    address = (d.links or {}).get(h.clip)
    if address is None or "window=" in address:
        return body
    return f'<a href="{address}&amp;t={h.seconds:.3f}">{body}</a>'


def _pose(h: Hexagon, joints: Sequence[str], left: float) -> str:
    """Return the stick figure that appears beside the map; the reader sees the dancer from the front."""
    x0, y0 = left + _SIDE / 2, _MAP[1] / 2 - 20
    ways: dict[str, str] = {}
    for side, parent, (x, y) in h.bones(joints):
        ends = f"M{x0 + parent[0] / 10:.0f} {y0 - parent[1] / 10:.0f}L{x0 + x / 10:.0f} {y0 - y / 10:.0f}"
        ways[side] = ways.get(side, "") + ends
    return "".join(f'<path class="pose bone {side}" d="{way}"/>' for side, way in ways.items())


def _nearness(poses: Poses) -> Figure | None:
    if not poses.to_train:
        return None

    def row(name: str, near: Nearness) -> tuple[object, ...]:
        return name, near.n, f"{rounded(100 * near.p50)} cm", f"{rounded(100 * near.p95)} cm"

    rows = [row(split, near) for split, near in poses.to_train.items()]
    if poses.chance is not None:
        rows.append(row("one half of train to the other", poses.chance))
    note = "rms over joints to the nearest pose of train; the halves show what is usual between clips"
    body = table(("split", "poses", "median", "95 %"), rows)
    return Figure("nearness", "Distance of poses to train", note, body)


def _frechet(poses: Poses) -> Figure | None:
    rows = [
        (f"{_FEATURES[kind]} {split}", rounded(levels.value), rounded(levels.chance_p50),
         f"{rounded(levels.chance_min)} to {rounded(levels.chance_max)}")
        for kind, by_split in poses.frechet.items()
        for split, levels in by_split.items()
    ]  # fmt: skip
    if not rows:
        return None
    note = (
        f"Frechet distances of features of clips, normalised by train; chance: {DRAWS} random parts of train of the "
        "split's size (at most half) against the rest: few clips make large distances"
    )
    return Figure("frechet", "Splits as sets of dances", note, table(("", "to train", "chance", "range"), rows))


def _duplicates(d: FigureSpec) -> Figure | None:
    poses = d.numbers.poses
    if sum(n > 0 for n in poses.windows.values()) < 2:
        return None
    limit = f"{100 * DUPLICATE_M:g} cm"
    compared = ", ".join(f"{n:,} of {split}" for split, n in poses.windows.items())
    note = f"rms over joints and ten moments below {limit}; windows compared: {compared}"
    if not poses.n_duplicates:
        return Figure("duplicates", "Windows in two splits", note, "<p>None.</p>")
    rows = [
        (Markup(" ".join(_moment(d, clip, at) for clip, at in zip(pair.clips, pair.seconds, strict=True))),
         " and ".join(pair.splits), f"{rounded(100 * pair.distance_m)} cm")
        for pair in poses.duplicates[:_PAIRS]
    ]  # fmt: skip
    left = poses.n_duplicates - len(rows)
    more = f"; {left:,} more pairs" if left > 0 else ""
    body = scrolled(("windows", "splits", "distance"), rows)
    return Figure("duplicates", "Windows in two splits", note + more, body, kind="wide")


def _moment(d: FigureSpec, clip: str, seconds: float) -> str:
    return f"{d.link(clip)} <small>at {seconds:.1f} s</small>"

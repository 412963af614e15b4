"""Charts as SVG text: histograms, bars, boxes, points. Colours are classes, so that the page's theme sets them."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dancedata.report.markup import escaped, number
from dancedata.report.tally import nice_step

#: Size of a chart in units of the page's text, and its margins.
WIDTH, HEIGHT = 420, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 10, 8, 40
#: Left of horizontal bars there is room for a name.
_NAMES, _ROW = 128, 19
#: Characters of a name in a chart; its title and the table have all of it.
_SHORT = 18

Scale = Callable[[float], float]


def drawn(body: str, label: str, height: float = HEIGHT, width: float = WIDTH, kind: str = "") -> str:
    """Return an SVG image with a name for assistive technology."""
    attributes = f'role="img" aria-label="{escaped(label)}"' + (f' class="{kind}"' if kind else "")
    return f'<svg viewBox="0 0 {width:g} {height:g}" {attributes}>{body}</svg>'


def _text(x: float, y: float, text: str, anchor: str = "middle", kind: str = "") -> str:
    attributes = f' class="{kind}"' if kind else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{attributes}>{escaped(text)}</text>'


def _short(name: str) -> str:
    return name if len(name) <= _SHORT else f"{name[: _SHORT - 1]}…"


def ticks(low: float, high: float, n: int) -> list[float]:
    """Return round numbers from `low` to `high`, about `n`."""
    step = nice_step(high - low, n)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [round(k * step, 10) for k in range(first, last + 1)]


def axes(xs: tuple[float, float], top: float, label: str, unit: str) -> tuple[Scale, Scale, str]:
    """Return functions from values to places, and the axes: x from `xs`, y from 0 to `top`."""
    right, bottom = WIDTH - _RIGHT, HEIGHT - _BOTTOM

    def x(value: float) -> float:
        return _LEFT + (value - xs[0]) / ((xs[1] - xs[0]) or 1) * (right - _LEFT)

    def y(value: float) -> float:
        return bottom - value / (top or 1) * (bottom - _TOP)

    lines = [
        f'<path class="grid" d="M{_LEFT} {y(v):.1f}H{right}"/>{_text(_LEFT - 6, y(v) + 4, number(v) + unit, "end")}'
        for v in ticks(0, top, 4)
    ]
    lines += [_text(x(v), bottom + 15, number(v)) for v in ticks(*xs, 6)]
    lines.append(_text((_LEFT + right) / 2, HEIGHT - 5, label, kind="label"))
    return x, y, "".join(lines)


def histogram(
    edges: Sequence[float],
    groups: Mapping[str, Sequence[int]],
    label: str,
    *,
    other: Sequence[int] | None = None,
    chance: Sequence[int] | None = None,
    marks: Sequence[tuple[float, str]] = (),
) -> str:
    """Return stacked bars in per cent of all, and the outlines of other counts in per cent of theirs.

    Parameters
    ----------
    other, chance
        Counts of another dataset, and those to be expected by chance.
    marks
        Values with a name that a line marks, such as a median.
    """
    counts = {name: np.asarray(values, dtype=np.float64) for name, values in groups.items()}
    total = sum(float(c.sum()) for c in counts.values())
    if not total:
        return drawn(_text(WIDTH / 2, 40, "no values"), label, 60)
    shares = {name: 100 * c / total for name, c in counts.items()}
    samples = {"chance": np.asarray(chance or (), np.float64), "other": np.asarray(other or (), np.float64)}
    outlines = {kind: 100 * sample / sample.sum() for kind, sample in samples.items() if sample.any()}
    stacked = np.sum(list(shares.values()), axis=0)
    highest = max(float(sample.max()) for sample in (stacked, *outlines.values()))
    x, y, body = axes((edges[0], edges[-1]), highest * 1.06, label, "%")
    base = np.zeros(len(edges) - 1)
    for k, (name, share) in enumerate(shares.items()):
        for b, height in enumerate(share.tolist()):
            if height:
                left, width = x(edges[b]) + 0.5, max(0.8, x(edges[b + 1]) - x(edges[b]) - 1)
                prefix = f"{name}, " if len(shares) > 1 else ""
                title = f"{prefix}{number(edges[b])} to {number(edges[b + 1])}: {int(counts[name][b]):,}"
                body += _bar(k, left, y(base[b] + height), width, y(base[b]) - y(base[b] + height), title)
        base += share
    for kind, outline in outlines.items():
        steps = "".join(f"V{y(v):.1f}H{x(e):.1f}" for v, e in zip(outline.tolist(), edges[1:], strict=True))
        body += f'<path class="{kind}" d="M{x(edges[0]):.1f} {y(0):.1f}{steps}V{y(0):.1f}"/>'
    for value, name in marks:
        if edges[0] <= value <= edges[-1]:
            way = f"M{x(value):.1f} {_TOP}V{HEIGHT - _BOTTOM}"
            body += f'<path class="mark" d="{way}"><title>{escaped(name)}</title></path>'
    return drawn(body, label)


def _bar(k: int, x: float, y: float, width: float, height: float, title: str) -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"'
    return f'<rect class="s{k % 6}" {place}><title>{escaped(title)}</title></rect>'


def bars(
    rows: Mapping[str, Mapping[str, float]], label: str, *, other: Mapping[str, float] | None = None, unit: str = ""
) -> str:
    """Return one horizontal bar a row, stacked by group; the outline of another total around it."""
    totals = {name: sum(counts.values()) for name, counts in rows.items()}
    most = max([*totals.values(), *(other or {}).values(), 0]) or 1
    room = WIDTH - _NAMES - 52
    body = ""
    for row, (name, counts) in enumerate(rows.items()):
        y, x = 4 + row * _ROW, float(_NAMES)
        body += f"<g><title>{escaped(name)}</title>{_text(_NAMES - 7, y + 11, _short(name), 'end')}</g>"
        for k, (group, value) in enumerate(counts.items()):
            width = value / most * room
            if value:
                title = (
                    f"{name}, {group}: {number(value)}{unit}" if len(counts) > 1 else f"{name}: {number(value)}{unit}"
                )
                body += _bar(k, x, y, max(1.0, width - 1), 13, title)
            x += width
        if other is not None and name in other:
            length = other[name] / most * room
            body += f'<rect class="other" x="{_NAMES}" y="{y - 1.5}" width="{length:.1f}" height="16"/>'
            x = max(x, _NAMES + length)
        body += _text(x + 6, y + 11, f"{number(totals[name])}{unit}", "start", "value")
    return drawn(body, label, 8 + _ROW * len(rows))


Quantiles = Mapping[str, float | None]


def boxes(
    rows: Mapping[str, Quantiles],
    label: str,
    *,
    classes: Mapping[str, str],
    other: Mapping[str, Quantiles] | None = None,
) -> str:
    """Return one box a row: a line from p5 to p95, a box from p25 to p75, a mark at p50.

    Parameters
    ----------
    classes
        Class of the colour of each row.
    other
        The same of another dataset: the outline of its box, with its p50.
    """
    beside = {
        name: quantiles for name, quantiles in (other or {}).items() if name in rows and quantiles["p50"] is not None
    }
    all_rows = [*rows.values(), *beside.values()]
    most = max([v for quantiles in all_rows for v in quantiles.values() if v is not None] or [1.0]) or 1.0
    room, bottom = WIDTH - _NAMES - 16, 6 + _ROW * len(rows)

    def x(value: float | None) -> float:
        return _NAMES + (value or 0) / most * room

    body = "".join(
        f'<path class="grid" d="M{x(v):.1f} 2V{bottom}"/>{_text(x(v), bottom + 15, number(v))}'
        for v in ticks(0, most, 5)
    )
    for row, (name, quantiles) in enumerate(rows.items()):
        y = 11 + row * _ROW
        low, left, middle, right, high = (x(quantiles[q]) for q in ("p5", "p25", "p50", "p75", "p95"))
        numbers = ", ".join(f"{q} {number(quantiles[q])}" for q in quantiles)
        body += _text(_NAMES - 7, y + 4, _short(name), "end")
        body += (
            f'<g class="{classes.get(name, "s0")}"><title>{escaped(name)}: {escaped(numbers)}</title>'
            f'<path class="whisker" d="M{low:.1f} {y}H{high:.1f}"/>'
            f'<rect x="{left:.1f}" y="{y - 5}" width="{max(right - left, 1):.1f}" height="10"/>'
            f'<path class="median" d="M{middle:.1f} {y - 7}v14"/></g>'
        )
        if name in beside:
            left, middle, right = (x(beside[name][q]) for q in ("p25", "p50", "p75"))
            outline = f"M{left:.1f} {y - 7.5}H{right:.1f}v15H{left:.1f}zM{middle:.1f} {y - 7.5}v15"
            body += f'<path class="other" d="{outline}"/>'
    body += _text(_NAMES + room / 2, bottom + 32, label, kind="label")
    return drawn(body, label, bottom + 38)


Pair = tuple[float, float, str]


def points(pairs: Sequence[Pair], labels: tuple[str, str], *, other: Sequence[Pair] = ()) -> str:
    """Return points with the diagonal on which both numbers are equal, and those of its double and its half.

    Parameters
    ----------
    pairs
        Two numbers and a name.
    other
        Those of another dataset, which are rings.
    """
    values = [v for a, b, _ in (*pairs, *other) for v in (a, b)]
    low, high = min(values), max(values)
    span = (low - 0.08 * (high - low or low or 1), high + 0.08 * (high - low or low or 1))
    size, left, top = 300.0, 48.0, 8.0

    def x(value: float) -> float:
        return left + (value - span[0]) / (span[1] - span[0]) * size

    def y(value: float) -> float:
        return top + size - (value - span[0]) / (span[1] - span[0]) * size

    body = ""
    for v in ticks(*span, 6):
        body += f'<path class="grid" d="M{left} {y(v):.1f}h{size}M{x(v):.1f} {top}v{size}"/>'
        body += _text(left - 6, y(v) + 4, number(v), "end") + _text(x(v), top + size + 15, number(v))
    for factor in (0.5, 1.0, 2.0):
        a, b = max(span[0], span[0] / factor), min(span[1], span[1] / factor)
        if a < b:
            kind = "mark" if factor == 1 else "mark faint"
            body += f'<path class="{kind}" d="M{x(a):.1f} {y(a * factor):.1f}L{x(b):.1f} {y(b * factor):.1f}"/>'
    for kind, radius, dots in (("s0", 4, pairs), ("other", 6.5, other)):
        for a, b, name in dots:
            title = f"<title>{escaped(f'{name}: {number(a)}, {number(b)}')}</title>"
            body += f'<circle class="{kind}" cx="{x(a):.1f}" cy="{y(b):.1f}" r="{radius}">{title}</circle>'
    body += _text(left + size / 2, top + size + 32, labels[0], kind="label")
    body += f'<g transform="rotate(-90 12 {top + size / 2})">{_text(12, top + size / 2, labels[1], kind="label")}</g>'
    return drawn(body, f"{labels[1]} against {labels[0]}", top + size + 38, WIDTH)

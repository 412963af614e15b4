"""Charts, paths and column ranges as SVG text.

Colours are classes, so that the page's theme sets them.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict

import numpy as np

from dancedata.core.columns import Columns
from dancedata.core.text import counted
from dancedata.pages.bin_counts import Quantiles, nice_step
from dancedata.pages.document import ColumnRange
from dancedata.pages.markup import Markup, escaped, number

#: Size of a chart in units of the page's text, and its margins.
WIDTH, HEIGHT = 420, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 10, 8, 40
#: Left of horizontal bars there is room for a name.
_NAMES, _ROW = 128, 19
#: Width of a digit.
_DIGIT = 7
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
    lines: Mapping[str, Sequence[int]] | None = None,
    marks: Sequence[tuple[float, str]] = (),
) -> str:
    """Return stacked bars in per cent of all, and the outlines of other counts in per cent of theirs."""
    counts = {name: np.asarray(values, dtype=np.float64) for name, values in groups.items()}
    total = sum(float(c.sum()) for c in counts.values())
    if not total:
        return drawn(_text(WIDTH / 2, 40, "no values"), label, 60)
    shares = {name: 100 * c / total for name, c in counts.items()}
    samples = {"chance": np.asarray(chance or (), np.float64), "other": np.asarray(other or (), np.float64)}
    outlines = {kind: 100 * sample / sample.sum() for kind, sample in samples.items() if sample.any()}
    parts = {name: np.asarray(line, np.float64) for name, line in (lines or {}).items()}
    parts = {name: 100 * part / part.sum() for name, part in parts.items()}
    stacked = np.sum(list(shares.values()), axis=0)
    highest = max(float(sample.max()) for sample in (stacked, *outlines.values(), *parts.values()))
    x, y, body = axes((edges[0], edges[-1]), highest * 1.06, label, "%")
    base = np.zeros(len(edges) - 1)
    for k, (name, share) in enumerate(shares.items()):
        for b, height in enumerate(share.tolist()):
            if height:
                left, width = x(edges[b]) + 0.5, max(0.8, x(edges[b + 1]) - x(edges[b]) - 1)
                prefix = f"{name}, " if len(shares) > 1 else ""
                title = f"{prefix}{number(edges[b])} to {number(edges[b + 1])}: {int(counts[name][b]):,}"
                box = left, y(base[b] + height), width, y(base[b]) - y(base[b] + height)
                body += _bar(k, *box, title) if lines is None else _bar(k, *box, title, kind="pale")
        base += share
    kinds = [(f"line s{k % 6}", part) for k, part in enumerate(parts.values())]
    for kind, outline in [*outlines.items(), *kinds]:
        steps = "".join(f"V{y(v):.1f}H{x(e):.1f}" for v, e in zip(outline.tolist(), edges[1:], strict=True))
        body += f'<path class="{kind}" d="M{x(edges[0]):.1f} {y(0):.1f}{steps}V{y(0):.1f}"/>'
    for value, name in marks:
        if edges[0] <= value <= edges[-1]:
            way = f"M{x(value):.1f} {_TOP}V{HEIGHT - _BOTTOM}"
            body += f'<path class="mark" d="{way}"><title>{escaped(name)}</title></path>'
    return drawn(body, label)


def _bar(k: int, x: float, y: float, width: float, height: float, title: str, kind: str = "") -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"'
    return f'<rect class="{kind or f"s{k % 6}"}" {place}><title>{escaped(title)}</title></rect>'


def bars(
    rows: Mapping[str, Mapping[str, float]], label: str, *, other: Mapping[str, float] | None = None, unit: str = "",
    links: Mapping[str, Markup] | None = None,
) -> str:  # fmt: skip
    """Return one horizontal bar per row, stacked by group; the outline of another total around it."""
    totals = {name: sum(counts.values()) for name, counts in rows.items()}
    most = max([*totals.values(), *(other or {}).values(), 0]) or 1
    room = WIDTH - _NAMES - (52 if other is None else 104)
    body = ""
    for row, (name, counts) in enumerate(rows.items()):
        y, x = 4 + row * _ROW, float(_NAMES)
        address = (links or {}).get(name)
        body += "" if address is None else f'<a href="{address}">'
        body += f"<g><title>{escaped(name)}</title>{_text(_NAMES - 7, y + 11, _short(name), 'end')}</g>"
        for k, (group, value) in enumerate(counts.items()):
            width = value / most * room
            if value:
                title = (
                    f"{name}, {group}: {number(value)}{unit}" if len(counts) > 1 else f"{name}: {number(value)}{unit}"
                )
                body += _bar(k, x, y, max(1.0, width - 1), 13, title)
            x += width
        body += "" if address is None else "</a>"
        text = f"{number(round(totals[name], 1) if unit else totals[name])}{unit}"
        if other is not None and name in other:
            length = other[name] / most * room
            body += f'<rect class="other" x="{_NAMES}" y="{y - 1.5}" width="{length:.1f}" height="16"/>'
            width, end = _DIGIT * len(text) + 6, _NAMES + length
            x = end if x < end < x + width else x  # the outline does not cross the number
            theirs = number(round(other[name], 1) if unit else other[name])
            body += _text(max(x + width + _DIGIT, end + 6), y + 11, f"({theirs}{unit})", "start", "beside")
        body += _text(x + 6, y + 11, text, "start", "value")
    return drawn(body, label, 8 + _ROW * len(rows))


def boxes(
    rows: Mapping[str, Quantiles],
    label: str,
    *,
    classes: Mapping[str, str],
    other: Mapping[str, Quantiles] | None = None,
) -> str:
    """Return one box per row: a line from p5 to p95, a box from p25 to p75, a mark at p50."""
    beside = {name: row for name, row in (other or {}).items() if name in rows and row.p50 is not None}
    all_rows = [*rows.values(), *beside.values()]
    most = max([v for row in all_rows for v in vars(row).values() if v is not None] or [1.0]) or 1.0
    room, bottom = WIDTH - _NAMES - 16, 6 + _ROW * len(rows)

    def x(value: float | None) -> float:
        return _NAMES + (value or 0) / most * room

    body = "".join(
        f'<path class="grid" d="M{x(v):.1f} 2V{bottom}"/>{_text(x(v), bottom + 15, number(v))}'
        for v in ticks(0, most, 5)
    )
    for row, (name, quantiles) in enumerate(rows.items()):
        y = 11 + row * _ROW
        low, left, middle, right, high = map(x, vars(quantiles).values())
        numbers = ", ".join(f"{q} {number(value)}" for q, value in vars(quantiles).items())
        body += _text(_NAMES - 7, y + 4, _short(name), "end")
        body += (
            f'<g class="{classes.get(name, "s0")}"><title>{escaped(name)}: {escaped(numbers)}</title>'
            f'<path class="whisker" d="M{low:.1f} {y}H{high:.1f}"/>'
            f'<rect x="{left:.1f}" y="{y - 5}" width="{max(right - left, 1):.1f}" height="10"/>'
            f'<path class="median" d="M{middle:.1f} {y - 7}v14"/></g>'
        )
        if name in beside:
            left, middle, right = map(x, (beside[name].p25, beside[name].p50, beside[name].p75))
            outline = f"M{left:.1f} {y - 7.5}H{right:.1f}v15H{left:.1f}zM{middle:.1f} {y - 7.5}v15"
            body += f'<path class="other" d="{outline}"/>'
    body += _text(_NAMES + room / 2, bottom + 32, label, kind="label")
    return drawn(body, label, bottom + 38)


Pair = tuple[float, float, str]


def points(pairs: Sequence[Pair], labels: tuple[str, str], *, other: Sequence[Pair] = ()) -> str:
    """Return points with the diagonal on which both numbers are equal, and those of its double and its half."""
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


#: Groups whose shares of ones are a figure of their own.
_CONTACTS = ("contact", "foot_contact")
#: Most columns of a group in the strips.
_STRIPS = 200
#: Size of a path's square, and of a group's strips.
_SQUARE, _PANEL = 130.0, (1040.0, 76.0)


def paths(clips: Mapping[str, Sequence[Sequence[float]]], links: Mapping[str, str]) -> str:
    """Return the paths of roots seen from above, all at one scale, under the links of their clips."""
    reach = max((abs(v) for path in clips.values() for point in path for v in point), default=1.0) or 1.0
    cells = [f"<li>{links[clip]}{_path(clip, path, reach)}</li>" for clip, path in clips.items()]
    return f'<ul class="paths">{"".join(cells)}</ul>'


def _path(clip: str, path: Sequence[Sequence[float]], reach: float) -> str:
    half = _SQUARE / 2

    def place(point: Sequence[float]) -> str:
        return f"{half + point[0] / reach * (half - 8):.1f} {half + point[1] / reach * (half - 8):.1f}"

    line = "L".join(map(place, path))
    first, last = (place(p).split() for p in (path[0], path[-1]))
    body = (
        f'<rect class="frame" x="1" y="1" width="{_SQUARE - 2}" height="{_SQUARE - 2}" rx="4"/>'
        f'<path class="grid" d="M{half} 8V{_SQUARE - 8}M8 {half}H{_SQUARE - 8}"/><path class="way" d="M{line}"/>'
        f'<circle class="s0" cx="{first[0]}" cy="{first[1]}" r="3.5"/>'
        f'<circle class="end" cx="{last[0]}" cy="{last[1]}" r="3.5"/>'
    )
    return drawn(body, f"path of {clip}, from above", _SQUARE, _SQUARE)


def strips(columns: Columns, rows: Sequence[ColumnRange], other: Mapping[str, ColumnRange] | None = None) -> str:
    """Return a panel for each group of columns: range, quartiles and median of each column."""
    panels = []
    for group in columns.groups:
        whole = list(rows[columns.slice(group.name)])
        title = f"{group.name}, {group.unit}".removesuffix(", 1")  # a unit of 1 is none
        if group.name in _CONTACTS and all(_is_binary(row) for row in whole):
            panels.append(f"<p>{escaped(title)}: {counted(len(whole), 'column')} of 0 and 1; see Feet in contact</p>")
            continue
        if all(_is_binary(row) for row in whole):
            panels.append(_shares(title, whole, other or {}))
            continue
        lines = by_joint(whole)
        beside = (
            {row.label: row for row in by_joint([other[row.label] for row in whole if row.label in (other or {})])}
            if other
            else {}
        )
        step = -(-len(lines) // _STRIPS)
        count = counted(len(whole), "column")
        of_joints = f", one mark for each of {len(lines)} joints" if len(lines) < len(whole) else ""
        thinned = f", one of {step} is drawn" if step > 1 else ""
        panels.append(_panel(title, f"{title}: {count}{of_joints}{thinned}", lines[::step], beside))
    return f'<div class="scroll">{"".join(panels)}</div>'


def by_joint(rows: Sequence[ColumnRange]) -> list[ColumnRange]:
    """Return one row for the columns of each joint: the least and the largest of their numbers, no median."""
    joints: dict[str, list[ColumnRange]] = {}
    for row in rows:
        parts = row.label.split(".")
        joints.setdefault(".".join(parts[:-1]) if len(parts) > 2 else row.label, []).append(row)
    return [
        of_joint[0] if len(of_joint) == 1 else ColumnRange(
            name, min(r.min for r in of_joint), min(r.p5 for r in of_joint), min(r.p25 for r in of_joint), None,
            max(r.p75 for r in of_joint), max(r.p95 for r in of_joint), max(r.max for r in of_joint),
        )
        for name, of_joint in joints.items()
    ]  # fmt: skip


def _is_binary(row: ColumnRange) -> bool:
    values = {row.min, row.p5, row.p25, row.p50, row.p75, row.p95, row.max}
    return row.mean is not None and values <= {0.0, 1.0}


def _shares(title: str, rows: Sequence[ColumnRange], other: Mapping[str, ColumnRange]) -> str:
    def shares(rows: Iterable[ColumnRange]) -> dict[str, float]:
        return {row.label.rpartition(".")[2]: round(100 * (row.mean or 0), 1) for row in rows}

    drawn_rows = {name: {"": share} for name, share in shares(rows).items()}
    beside = shares(other[row.label] for row in rows if row.label in other) if other else None
    body = bars(drawn_rows, f"share of ones of {title}", other=beside, unit=" %")
    return f"<p>{escaped(title)}: {counted(len(rows), 'column')}, share of rows that are 1</p>{body}"


def _panel(title: str, caption: str, rows: Sequence[ColumnRange], other: Mapping[str, ColumnRange]) -> str:
    both = [*rows, *(other[row.label] for row in rows if row.label in other)]
    low, high = min(row.min for row in both), max(row.max for row in both)
    (width, height), left, top = _PANEL, 62.0, 16.0

    def y(value: float) -> float:
        return float(top + (height - top - 6) * (1 - (value - low) / ((high - low) or 1)))

    room = (width - left - 6) / len(rows)
    body = f'<text x="{left}" y="11" text-anchor="start">{escaped(caption)}</text>'
    for value in dict.fromkeys((low, high)):
        body += f'<text x="{left - 5}" y="{y(value) + 4:.1f}" text-anchor="end">{number(value)}</text>'
        body += f'<path class="grid" d="M{left} {y(value):.1f}H{width - 6}"/>'
    for k, row in enumerate(rows):
        x, thick = left + (k + 0.5) * room, min(8.0, room * 0.7)
        constant = row.max - row.min < 1e-6
        text = f"{row.label}: " + ", ".join(
            f"{q} {number(v)}" for q, v in asdict(row).items() if q != "label" and v is not None
        )
        body += (
            f'<g class="{"constant" if constant else "s0"}"><title>{escaped(text)}</title>'
            f'<path class="whisker" d="M{x:.1f} {y(row.min):.1f}V{y(row.max):.1f}"/>'
            f'<rect x="{x - thick / 2:.1f}" y="{y(row.p75):.1f}" width="{thick:.1f}" '
            f'height="{max(1.0, y(row.p25) - y(row.p75)):.1f}"/>'
            + (f'<path class="cross" d="M{x - 3:.1f} {y(low) - 3:.1f}l6 6m0 -6l-6 6"/>' if constant else "")
            + "</g>"
        )
        if row.label in other:
            beside = other[row.label]
            top_of, wide = y(beside.max), max(2.0, room * 0.9)
            body += (
                f'<rect class="other thin" x="{x - wide / 2:.1f}" y="{top_of:.1f}" width="{wide:.1f}" '
                f'height="{max(1.0, y(beside.min) - top_of):.1f}"/>'
            )
    return drawn(body, f"ranges of {title}", height, width, "panel")

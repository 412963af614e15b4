"""The figures of the columns of fields: their ranges, their scaler, their values over time."""

from collections.abc import Mapping

from dancedata.core.columns import Columns
from dancedata.core.text import listed
from dancedata.pages.document import FieldNumbers
from dancedata.pages.figures import FigureSpec
from dancedata.pages.markup import Figure, number, rounded, scrolled
from dancedata.pages.scaling import EXPLODES, NARROW, ScaledGroup
from dancedata.pages.svg import strips


def column_figures(d: FigureSpec, columns: Mapping[str, Columns], heat_maps: Mapping[str, Figure]) -> list[Figure]:
    """Return the figures of each field, with the heat maps of those that have one."""
    figures = []
    for name, field in d.numbers.fields.items():
        if field.columns:
            figures.append(_ranges(d, name, field, columns[name]))
        if field.scaling:
            figures.append(_scaling(name, field))
        if name in heat_maps:
            figures.append(heat_maps[name])
    return figures


def _ranges(d: FigureSpec, name: str, field: FieldNumbers, columns: Columns) -> Figure:
    constant = "no column is constant"
    if field.constant:
        constant = f"{len(field.constant)} never change (crosses): {listed(field.constant, 8)}"
    text = (
        f"{field.width} columns, {field.rate} per second, over {field.rows:,} rows of train windows; "
        f"{constant}; line: range, box: 25 to 75 %, of all columns of a joint"
    )
    other = None if d.other is None else d.other.fields.get(name)
    beside = {} if other is None else {row.label: row for row in other.columns}
    extra = ("min", "p50", "max") if beside else ()
    head = ("column", "min", "p5", "p25", "p50", "p75", "p95", "max", "mean", *(f"{q}, other" for q in extra))
    rows = tuple(
        (*vars(row).values(), *(getattr(beside.get(row.label), q, None) for q in extra)) for row in field.columns
    )
    return Figure(f"columns_{name}", f"Ranges of {name}", text, strips(columns, field.columns, beside), head, rows,
                  other=d.outline if beside else "", kind="wide")  # fmt: skip


def _scaling(name: str, field: FieldNumbers) -> Figure:
    head = ("group", "unit", "columns", "min", "max", "std", "at 5 sigma", "largest elsewhere",
            f"range below {NARROW:g}", "explode")  # fmt: skip
    body = scrolled(head, [_scaled(group) for group in field.scaling])
    text = (
        "EDGE's scaler maps the range of train windows to −1 to 1; std: median of columns; at 5 sigma and largest "
        f"elsewhere (in other splits): normalised values; a column explodes beyond {EXPLODES:g}"
    )
    return Figure(f"scaling_{name}", f"Scaler of {name}", text, body, kind="wide")


def _scaled(group: ScaledGroup) -> tuple[object, ...]:
    exploding = listed([f"{label} {rounded(value)}" for label, value in group.exploding], 4)
    return (
        group.group, group.unit, group.width, group.min, group.max, group.std, rounded(group.five_sigma),
        "–" if group.largest is None else rounded(group.largest),
        f"{number(len(group.narrow))}: {listed(group.narrow, 2)}" if group.narrow else "0", exploding or "0",
    )  # fmt: skip

"""Compares lines of JSON whose floating-point numbers may differ within a tolerance."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]


def is_same_number(a: Any, b: Any, atol: float | None) -> bool:
    """Whether two values are equal, floating-point numbers within the tolerance."""
    if atol is not None and isinstance(a, float) and isinstance(b, float):
        return abs(a - b) <= atol
    return bool(a == b)


def unmatched(one: Sequence[Row], two: Sequence[Row], atol: float | None) -> tuple[list[Row], list[Row]]:
    """Return the rows of each side without an equal row on the other side, in order.

    Rows are equal if floating-point numbers are equal within the tolerance, and all other values exactly.
    """
    sides = _by_text(one), _by_text(two)
    left: tuple[dict[int, Row], dict[int, Row]] = ({}, {})
    for text in {**sides[0], **sides[1]}:
        mine, other = (sorted(side.get(text, ()), key=lambda entry: entry[0]) for side in sides)
        for a, b in _pairs(mine, other, atol):
            if a is not None:
                left[0][a[1]] = one[a[1]]
            if b is not None:
                left[1][b[1]] = two[b[1]]
    return [left[0][k] for k in sorted(left[0])], [left[1][k] for k in sorted(left[1])]


_Entry = tuple[tuple[float, ...], int]


def _by_text(rows: Sequence[Row]) -> dict[str, list[_Entry]]:
    """Return floating-point numbers and index of each row, by the rest of the row; equal rows count once."""
    found: dict[str, dict[tuple[float, ...], int]] = defaultdict(dict)
    for index, row in enumerate(rows):
        numbers: list[float] = []
        text = json.dumps(_without_floats(row, numbers), sort_keys=True)
        found[text].setdefault(tuple(numbers), index)
    return {text: list(entries.items()) for text, entries in found.items()}


def _without_floats(value: Any, numbers: list[float]) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_floats(value[key], numbers) for key in sorted(value)}
    if isinstance(value, list):
        return [_without_floats(item, numbers) for item in value]
    if isinstance(value, float):
        numbers.append(value)
        return "a number"
    return value


def _pairs(
    mine: list[_Entry], other: list[_Entry], atol: float | None
) -> Iterator[tuple[_Entry | None, _Entry | None]]:
    """Yield entries without an equal one; both lists are sorted by their numbers."""
    i = j = 0
    while i < len(mine) and j < len(other):
        a, b = mine[i], other[j]
        if all(is_same_number(x, y, atol) for x, y in zip(a[0], b[0], strict=True)):
            i, j = i + 1, j + 1
        elif a[0] < b[0]:
            yield a, None
            i += 1
        else:
            yield None, b
            j += 1
    for a in mine[i:]:
        yield a, None
    for b in other[j:]:
        yield None, b

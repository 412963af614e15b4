"""Tables of a store as pandas has them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from dancedata.core.clip import Window
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.packages import load
from dancedata.core.text import shown
from dancedata.store.clip_columns import FREE, ClipRecord
from dancedata.store.row_queries import RowQueries

if TYPE_CHECKING:
    from pandas import DataFrame


def table_of(store: RowQueries, clips: Iterable[ClipRecord], name: str) -> DataFrame:
    """Return a table of `Store.to_pandas`; UsageError for an unknown one, or without pandas."""
    if not isinstance(name, str) or name not in _TABLES:
        raise UsageError(f"no table named {shown(name)!r}", fix=did_you_mean(str(name), _TABLES))
    pandas = load("pandas", "pandas", what="to_pandas")
    rows = list(_TABLES[name](store, clips))
    frame: DataFrame = pandas.DataFrame.from_records(rows, columns=None if rows else _EMPTY[name])
    for column, kind in store.free_types.items() if name == "clips" and rows else ():
        values = [row[column] for row in rows]
        if kind == "int" and None in values:  # pandas would make them float64, which has 53 bits
            frame[column] = pandas.array(values, dtype="Int64")
    return frame


def clip_row(store: RowQueries, clip: ClipRecord) -> dict[str, Any]:
    """Return a clip's row of the table of clips."""
    row = {"id": clip.id, "split": clip.split, "seconds": float(store.grid.seconds(clip.n_frames))}
    names = [each.name for each in fields(ClipRecord) if each.name not in {*row, "columns"}]
    row |= {name: _plain(getattr(clip, name)) for name in names}
    terms = store.licences[clip.licence].text if clip.licence >= 0 else ""
    row["licence"] = terms or str(store.info.get("licence") or "")
    row |= {"without": list(store._without(clip.id, store.fields))} if store.optional_fields else {}
    return row | {name: clip.columns.get(name.removeprefix(FREE)) for name in store._tables.types}


def window_row(store: RowQueries, split: str, window: Window) -> dict[str, Any]:
    """Return a row of the table of windows."""
    seconds = float(store.grid.seconds(window.start)), float(store.grid.seconds(window.length))
    return {"clip": window.clip, "split": split, "start": window.start, "length": window.length,
            "start_s": seconds[0], "length_s": seconds[1]}  # fmt: skip


def _windows(store: RowQueries, clips: Iterable[ClipRecord]) -> Iterator[dict[str, Any]]:
    fields = store.required_fields  # windows of clips without an optional field as well
    return (
        window_row(store, split, window) for split in store.splits for window in store.windows(split, fields=fields)
    )


def _plain(value: Any) -> Any:
    """Return a value as a cell: exact fractions as numbers, tuples as lists."""
    if isinstance(value, tuple):
        return list(value)
    return float(value) if hasattr(value, "numerator") and not isinstance(value, int) else value


_TABLES: Mapping[str, Callable[[RowQueries, Iterable[ClipRecord]], Iterator[dict[str, Any]]]] = {
    "clips": lambda store, clips: (clip_row(store, clip) for clip in clips),
    "windows": _windows,
    "rejects": lambda store, clips: iter(store.rejects),
    "quality": lambda store, clips: iter(store.quality),
}

#: Columns of a table without rows, so that a filter on one of them finds nothing instead of failing.
_EMPTY: Mapping[str, list[str]] = {
    "clips": ["id", "split", "seconds", "n_frames"],
    "windows": ["clip", "split", "start", "length", "start_s", "length_s"],
    "rejects": ["clip", "file", "reason", "detail"],
    "quality": ["clip", "kind", "joint", "frame", "value", "unit", "rate"],
}

"""Which clips have some values, by the columns of the table of clips."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import quoted
from dancedata.store.clip_columns import CLIP_COLUMNS
from dancedata.store.columns import Texts
from dancedata.store.row_queries import RowQueries
from dancedata.store.tables import Tables

#: Columns that can be chosen by, beside free ones.
_CHOOSABLE = ("genre", "music", "dancer", "role", "member", "lists", "tempo_bpm", "height_m", "n_flags")
_TYPES = {c.name: c.kind.removesuffix("32") for c in CLIP_COLUMNS if c.name in _CHOOSABLE} | {"clip": "text"}
_DEFAULTS: Mapping[str, Any] = {column.name: column.default for column in CLIP_COLUMNS}
#: Python types of the values that a column is compared with.
_COMPARED: Mapping[str, tuple[type, ...]] = {
    "text": (str,), "texts": (str,), "int": (int,), "ints": (int,), "float": (int, float), "floats": (int, float),
    "bool": (bool,),
}  # fmt: skip


def require_where(store: RowQueries, where: Mapping[str, Any] | None) -> dict[str, tuple[Any, ...]]:
    """Return the values by column that clips may have; UsageError for an unknown column or values of another type."""
    if where is None:
        return {}
    if not isinstance(where, Mapping):
        raise UsageError("where is not a mapping", found=quoted(where, 60), allowed='such as {"x/level": (3, 4)}')
    types = {**_TYPES, **store._tables.types}
    chosen = {}
    for name, value in where.items():
        if name not in types:
            fix = did_you_mean(str(name), [*store._tables.types, "clip", *_CHOOSABLE])
            raise UsageError(f"where: no column {quoted(name, 60)}", where=str(store.path), fix=fix)
        values = tuple(value) if isinstance(value, (tuple, list, set, frozenset)) else (value,)
        allowed = _COMPARED[types[name]]
        wrong = [v for v in values if not isinstance(v, allowed) or (isinstance(v, bool) and bool not in allowed)]
        if wrong or not values:
            value_text = quoted(wrong[0], 60) if wrong else "no value"
            kind = "or ".join(f"{t.__name__} " for t in allowed).strip()
            raise UsageError(f"where: not a value of {name}", found=value_text, allowed=f"{kind}, or several of them")
        if name == "clip":
            for clip in values:
                store._row(clip)  # an unknown one is an error, with the closest id
        chosen[str(name)] = values
    return chosen


def clips_with(tables: Tables, name: str, values: tuple[Any, ...]) -> npt.NDArray[np.bool_]:
    """Return which clips (N,) have one of some values in a column."""
    column = tables.ids if name == "clip" else tables.columns.get(name)
    if column is None:  # not stored, as all clips have the default; of a free column, no value
        return np.full(tables.n_clips, any(value == _DEFAULTS.get(name, "") for value in values))
    if isinstance(column, np.ndarray):
        return np.isin(column, [int(v) if isinstance(v, bool) else v for v in values])
    if isinstance(column, Texts):
        return column.isin(values)
    wanted = set(values)
    return np.fromiter((not wanted.isdisjoint(cell) for cell in column), dtype=np.bool_, count=tables.n_clips)

"""Columns of the table of clips: which clips a reader takes, and values that its samples have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Reject
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import counted, listed, quoted
from dancedata.store.clip_columns import CLIP_COLUMNS, FREE
from dancedata.store.columns import MISSING, Texts
from dancedata.store.dataset import Store
from dancedata.store.tables import Tables
from dancedata.store.tables_out import free_types

#: Columns that can be chosen by, beside free ones.
_CHOOSABLE = ("genre", "music", "dancer", "role", "member", "lists", "tempo_bpm", "height_m", "n_flags")
_TYPES = {c.name: c.kind.removesuffix("32") for c in CLIP_COLUMNS if c.name in _CHOOSABLE} | {"clip": "text"}
_DEFAULTS: Mapping[str, Any] = {column.name: column.default for column in CLIP_COLUMNS}
#: End of the details of rejects.
ASKED = "as where= asks for"
#: Python types of the values that a column is compared with.
_COMPARED: Mapping[str, tuple[type, ...]] = {
    "text": (str,), "texts": (str,), "int": (int,), "ints": (int,), "float": (int, float), "floats": (int, float),
    "bool": (bool,),
}  # fmt: skip


def require_where(store: Store, where: Mapping[str, Any] | None) -> dict[str, tuple[Any, ...]]:
    """Return the values by column that clips may have; UsageError for an unknown column or values of another type."""
    if where is None:
        return {}
    if not isinstance(where, Mapping):
        raise UsageError("where is not a mapping", found=quoted(where, 60), allowed='such as {"x/level": (3, 4)}')
    types = {**_TYPES, **free_types(store)}
    chosen = {}
    for name, value in where.items():
        if name not in types:
            fix = did_you_mean(str(name), [*free_types(store), "clip", *_CHOOSABLE])
            raise UsageError(f"where: no column {quoted(name, 60)}", where=str(store.path), fix=fix)
        values = tuple(value) if isinstance(value, (tuple, list, set, frozenset)) else (value,)
        allowed = _COMPARED[types[name]]
        wrong = [v for v in values if not isinstance(v, allowed) or (isinstance(v, bool) and bool not in allowed)]
        if wrong or not values:
            found = quoted(wrong[0], 60) if wrong else "no value"
            kind = "or ".join(f"{t.__name__} " for t in allowed).strip()
            raise UsageError(f"where: not a value of {name}", found=found, allowed=f"{kind}, or several of them")
        if name == "clip":
            for clip in values:
                store.clip(clip)  # an unknown one is an error, with the closest id
        chosen[str(name)] = values
    return chosen


def chosen_clips(
    tables: Tables, where: Mapping[str, tuple[Any, ...]], among: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.bool_], list[Reject]]:
    """Return which of some clips (N,) have the values, and rejects of the others, by the first column."""
    chosen, rejects = among.copy(), []
    for name, values in where.items():
        has = _has(tables, name, values)
        for row in np.flatnonzero(chosen & ~has).tolist():
            detail = f"{name} is not {listed(map(repr, values), 3)}, {ASKED}"
            rejects.append(Reject("filtered", tables.ids[row], detail=detail))
        chosen &= has
    return chosen, sorted(rejects, key=lambda reject: reject.clip)


def _has(tables: Tables, name: str, values: tuple[Any, ...]) -> npt.NDArray[np.bool_]:
    column = tables.ids if name == "clip" else tables.columns.get(name)
    if column is None:  # not stored, as all clips have the default; of a free column, no value
        return np.full(tables.n_clips, any(value == _DEFAULTS.get(name, "") for value in values))
    if isinstance(column, np.ndarray):
        return np.isin(column, [int(v) if isinstance(v, bool) else v for v in values])
    if isinstance(column, Texts):
        return column.isin(values)
    wanted = set(values)
    return np.fromiter((not wanted.isdisjoint(cell) for cell in column), dtype=np.bool_, count=tables.n_clips)


def require_columns(
    store: Store, columns: Sequence[str], clips: Sequence[str] = (), *, lists: bool = False
) -> tuple[str, ...]:
    """Return the free columns that samples have.

    `columns`: Their names, "x/<name>".
    `clips`: Ids of the clips that are read: whole numbers and truth values have no value for "none", so that each of
        these clips needs one.
    `lists`: Whether a sample has a list of values, which may hold None.
    Raises UsageError: for an unknown column, and clips without a value.
    """
    names = (columns,) if isinstance(columns, str) else tuple(columns)
    types = free_types(store)
    for name in names:
        if name not in types:
            fix = did_you_mean(str(name), list(types)) if types else "build with free columns: docs/own-data.md"
            raise UsageError(f"no free column {quoted(name, 60)}", where=str(store.path), fix=fix)
        if types[name] in ("int", "bool") and not lists:
            key = name.removeprefix(FREE)
            without = [clip for clip in clips if key not in store.clip(clip).columns]
            if without:
                raise UsageError(
                    f"{name} has no value for {counted(len(without), 'clip')}, and batches of {types[name]} cannot "
                    "leave one out",
                    where=str(store.path), found=listed(without),
                    fix=f"fill it in, or choose clips: where={{{name!r}: ...}}",
                )  # fmt: skip
    return names


def value_of(store: Store, columns: Mapping[str, Any], name: str) -> Any:
    """Return the value of a free column in a sample: "", nan or [] where a clip has no text, number or list."""
    kind = free_types(store)[name]
    value = columns.get(name.removeprefix(FREE), MISSING[kind])
    return list(value) if isinstance(value, tuple) else value

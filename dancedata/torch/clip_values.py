"""Columns of the table of clips: which clips a reader takes, and values that its samples have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Reject
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import counted, listed, quoted
from dancedata.store.clip_choice import clips_with
from dancedata.store.clip_columns import FREE
from dancedata.store.columns import MISSING
from dancedata.store.dataset import Store
from dancedata.store.tables import Tables

#: End of the details of rejects.
ASKED = "as where= asks for"


def chosen_clips(
    tables: Tables, where: Mapping[str, tuple[Any, ...]], among: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.bool_], list[Reject]]:
    """Return which of some clips (N,) have the values, and rejects of the others, by the first column."""
    chosen, rejects = among.copy(), []
    for name, values in where.items():
        has = clips_with(tables, name, values)
        for row in np.flatnonzero(chosen & ~has).tolist():
            detail = f"{name} is not {listed(map(repr, values), 3)}, {ASKED}"
            rejects.append(Reject("filtered", tables.ids[row], detail=detail))
        chosen &= has
    return chosen, sorted(rejects, key=lambda reject: reject.clip)


def require_columns(
    store: Store, columns: Sequence[str], clips: Sequence[str] = (), *, lists: bool = False
) -> tuple[str, ...]:
    """Return the free columns that samples have; UsageError for unknown ones, and `clips` without a number."""
    names = (columns,) if isinstance(columns, str) else tuple(columns)
    types = store.free_types
    for name in names:
        if name not in types:
            fix = did_you_mean(str(name), list(types)) if types else "build with free columns, x/NAME"
            raise UsageError(f"no free column {quoted(name, 60)}", where=str(store.path), fix=fix)
        if types[name] in ("int", "bool") and not lists:
            key = name.removeprefix(FREE)
            without = [clip for clip in clips if key not in store[clip].columns]
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
    kind = store.free_types[name]
    value = columns.get(name.removeprefix(FREE), MISSING[kind])
    return list(value) if isinstance(value, tuple) else value

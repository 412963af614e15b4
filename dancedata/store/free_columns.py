"""Free columns of the table of clips in numbers: for `info`, reports and cards."""

from collections import Counter
from collections.abc import Iterable, Iterator
from statistics import median
from typing import Any

from dancedata.core.clip import FreeColumn
from dancedata.store.clip_columns import FREE, ClipRecord
from dancedata.store.row_queries import RowQueries

#: Most values of a column that are listed.
_VALUES = 12


def free_columns(store: RowQueries, clips: Iterable[ClipRecord]) -> tuple[FreeColumn, ...]:
    """Return the free columns of a dataset, by name."""
    types = store._tables.types
    of_clips = [clip for clip in clips if not clip.source] if types else []
    return tuple(_column(name, kind, of_clips) for name, kind in sorted(types.items()))


def _column(name: str, kind: str, clips: list[ClipRecord]) -> FreeColumn:
    key = name.removeprefix(FREE)
    held = [clip.columns[key] for clip in clips if key in clip.columns]
    entries = [entry for value in held for entry in _entries(value)]
    if kind in ("int", "float", "ints", "floats"):
        numbers = [float(entry) for entry in entries]
        least, middle, most = (f(numbers) if numbers else None for f in (min, median, max))
        return FreeColumn(name, kind, len(held), len(clips), least, middle, most, {}, len(set(entries)))
    counts = Counter(str(entry).lower() if kind == "bool" else entry for entry in entries)
    values = dict(sorted(counts.items(), key=lambda item: (-item[1], item[0]))[:_VALUES])
    return FreeColumn(name, kind, len(held), len(clips), None, None, None, values, len(counts))


def _entries(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple):
        yield from dict.fromkeys(value)
    else:
        yield value

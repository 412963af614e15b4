"""Free columns of the table of clips in numbers: for `info`, reports and cards."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median
from typing import Any

from dancedata.core.text import counted, shown
from dancedata.store.clip_columns import FREE
from dancedata.store.dataset import Store

#: Most values of a column that are listed.
_VALUES = 12


@dataclass(frozen=True)
class FreeColumn:
    """One free column, over the clips that are not copies.

    `name`: With the prefix, "x/level".
    `clips`, `of`: Clips with a value, and all.
    `least`, `middle`, `most`: Of numbers, also of those in lists; None for others.
    `values`: Texts and truth values, also those in lists: number of clips of the most frequent ones.
    `distinct`: Number of different values, or entries of lists.
    """

    name: str
    type: str
    clips: int
    of: int
    least: float | None
    middle: float | None
    most: float | None
    values: dict[str, int]
    distinct: int

    def __str__(self) -> str:
        held = f"{self.name}: {self.type}, {self.clips:,} of {counted(self.of, 'clip')}"
        if self.least is not None:
            return f"{held}, {self.least:g} to {self.most:g}, median {self.middle:g}"
        listed = ", ".join(f"{shown(value, 60)}: {n:,}" for value, n in self.values.items())
        more = f", {self.distinct - len(self.values):,} more" if self.distinct > len(self.values) else ""
        return f"{held}{': ' * bool(listed)}{listed}{more}"


def free_columns(store: Store) -> tuple[FreeColumn, ...]:
    """Return the free columns of a dataset, by name."""
    types = store._tables.types
    clips = [clip for clip in store if not clip.source] if types else []
    return tuple(_column(name, kind, clips) for name, kind in sorted(types.items()))


def _column(name: str, kind: str, clips: list[Any]) -> FreeColumn:
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
    """Yield a value, or the different entries of a list."""
    if isinstance(value, tuple):
        yield from dict.fromkeys(value)
    else:
        yield value

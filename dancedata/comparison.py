"""Differences between two built datasets."""

import json
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.hashing import document_differences, hashed_keys
from dancedata.core.segments import Segment
from dancedata.core.text import counted, listed, shown
from dancedata.kernel import CLIP_COLUMNS, Clip, SourceRecord, Store, open_store, source_differences

Row = Mapping[str, Any]


def is_same_number(a: Any, b: Any, atol: float | None) -> bool:
    """Return whether two values are equal, floating-point numbers within the tolerance."""
    if atol is not None and isinstance(a, float) and isinstance(b, float):
        return abs(a - b) <= atol
    return bool(a == b)


def unmatched(one: Sequence[Row], two: Sequence[Row], atol: float | None) -> tuple[list[Row], list[Row]]:
    """Return the rows of each side without an equal row on the other side, in order; equal rows count once.

    Rows are equal if floating-point numbers are equal within the tolerance, and all other values exactly.
    """
    sides, lonely = (_by_text(one), _by_text(two)), (list[int](), list[int]())
    for text in {**sides[0], **sides[1]}:
        ours, theirs = (sorted(side.get(text, {}).items(), reverse=True) for side in sides)
        while ours and theirs:  # the least numbers of both
            a, b = ours[-1][0], theirs[-1][0]
            if all(is_same_number(x, y, atol) for x, y in zip(a, b, strict=True)):
                ours.pop()
                theirs.pop()
            elif a < b:
                lonely[0].append(ours.pop()[1])
            else:
                lonely[1].append(theirs.pop()[1])
        for indices, entries in zip(lonely, (ours, theirs), strict=True):
            indices += [index for _, index in entries]
    return [one[k] for k in sorted(lonely[0])], [two[k] for k in sorted(lonely[1])]


def _by_text(rows: Sequence[Row]) -> dict[str, dict[tuple[float, ...], int]]:
    """Return the index of each row by its floating-point numbers, by the rest of the row."""
    by_text: dict[str, dict[tuple[float, ...], int]] = defaultdict(dict)
    for index, row in enumerate(rows):
        numbers: list[float] = []
        text = json.dumps(_without_floats(row, numbers), sort_keys=True)
        by_text[text].setdefault(tuple(numbers), index)
    return by_text


def _without_floats(value: Any, numbers: list[float]) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_floats(value[key], numbers) for key in sorted(value)}
    if isinstance(value, list):
        return [_without_floats(item, numbers) for item in value]
    if isinstance(value, float):
        numbers.append(value)
        return "a number"
    return value


#: Most names, and characters of a message, in a line; JSON has all of them.
_SHOWN, _MESSAGE = 5, 600
#: Keys shown of those that differ below one key.
_EXAMPLES = 2
_ABOUT_STORE = ("format", "fps", "windows", "genre_ids", "licence", "citation")
#: Hashes of sources and songs are compared as such.
_ABOUT_CLIP = ("split", *(c.name for c in CLIP_COLUMNS if c.name not in ("id", "made_of", "song")), "columns")
_NOTED = ("name", "versions")


@dataclass(frozen=True)
class Difference:
    """One thing in which two datasets differ.

    Attributes
    ----------
    kind
        recipe, source, store, fields, clips, windows, values, rejects, quality, segments; or note, for names and
        versions, which do not change the data.
    message
        The difference, A first.
    names
        Clips or fields that differ.
    """

    kind: str
    message: str
    names: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {**self.__dict__, "names": list(self.names), "numbers": dict(self.numbers)}

    def __str__(self) -> str:
        names = f": {listed(self.names, _SHOWN)}" if self.names else ""
        return f"{self.kind}: {shown(self.message, _MESSAGE)}{names}"


#: The key above the one that a difference names: "genre_ids" of "genre_ids.gBR: 0, null".
_ABOVE = re.compile(r"([^\s:]+)\.([^\s:.]+): ")


class Differences(list[Difference]):
    """The differences of two datasets."""

    def lines(self) -> list[str]:
        """Return a line for each; those of keys below one key, and those of several fields, are one line."""
        groups: dict[tuple[str, str], list[Difference]] = {}
        for difference in self:
            above = _ABOVE.match(difference.message)
            groups.setdefault((difference.kind, above[1] if above else difference.message), []).append(difference)
        lines = []
        for (kind, key), group in groups.items():
            if len(group) == 1:
                lines.append(str(group[0]))
            elif key == group[0].message:
                lines.append(str(Difference(kind, key, tuple(name for d in group for name in d.names))))
            else:
                examples = "; ".join(d.message.removeprefix(f"{key}.") for d in group[:_EXAMPLES])
                more = ", ..." if len(group) > _EXAMPLES else ""
                shortened = f"{shown(examples, _MESSAGE)}{more}"
                lines.append(f"{kind}: {counted(len(group), 'key')} of {key} differ: {shortened}")
        return lines


def diff(a: str | Path, b: str | Path, *, atol: float | None = None) -> Differences:
    """Compare two built datasets.

    Parameters
    ----------
    a, b
        Folders that `build` wrote. Their content is compared, independent of the borders of shards; use `check` to
        compare a dataset with its own dataset.json.
    atol
        Floating-point numbers that differ by no more than this are the same: values of fields, metadata of clips,
        numbers of rejects and quality flags. Whole numbers, texts and counts are compared exactly. A note says how
        much each field differs. None: everything is compared exactly.

    Returns
    -------
    Differences
        A list of `Difference`. Empty if they are equal; only notes if names or versions differ and the data do not.

    Raises
    ------
    StoreError
        If one of them is not a finished dataset, or a copy of the other with other bytes.
    UsageError
        If `atol` is not a number >= 0.

    Examples
    --------
    >>> from dancedata.comparison import diff
    >>> [str(difference) for difference in diff("data/aistpp", "data/the-same-again")]
    []
    """
    if atol is not None and not (math.isfinite(atol) and atol >= 0):
        raise UsageError("not a valid tolerance", found=repr(atol), allowed="a number >= 0, such as 0.001")
    with open_store(a) as one, open_store(b) as two:
        if one.info["self_sha256"] == two.info["self_sha256"]:
            one.require_intact()
            two.require_intact()
            return Differences()
        differences = [*_recipes(one, two), *_meta("store", one, two, _ABOUT_STORE), *_fields(one, two)]
        pairs = {c.id: c for c in two.clips()}
        common = [(c, pairs[c.id]) for c in one.clips() if c.id in pairs]
        differences += [*_clips(one, two, common, atol), *_windows(one, two), *_values(one, two, common, atol)]
        differences += _rows("rejects", one.rejects, two.rejects, atol)
        differences += _rows("quality", one.quality, two.quality, atol)
        differences += _segments(one, two, common)
        return Differences([*differences, *_meta("note", one, two, _NOTED)])


def _recipes(one: Store, two: Store) -> Iterator[Difference]:
    recipes = hashed_keys(one.info.get("recipe", {})), hashed_keys(two.info.get("recipe", {}))
    for key, old, new in document_differences(*recipes):
        yield Difference("recipe", f"{key}: {json.dumps(old)}, {json.dumps(new)}")
    sources = [str(store.info.get("source", {}).get("sha256")) for store in (one, two)]
    if sources[0] != sources[1]:
        hashes = [sha256[:12] for sha256 in sources]
        yield Difference("source", f"built from other files, splits or metadata of clips: {hashes[0]}, {hashes[1]}")
        records = SourceRecord.of_store(one), SourceRecord.of_store(two)
        # The metadata of clips are compared separately.
        for difference in source_differences(*records, "in A", "in B", about=False):
            yield Difference("source", difference.message, difference.names)


def _meta(kind: str, one: Store, two: Store, keys: Sequence[str]) -> Iterator[Difference]:
    ours, theirs = ({key: store.info.get(key) for key in keys} for store in (one, two))
    for key, old, new in document_differences(ours, theirs):
        yield Difference(kind, f"{key}: {json.dumps(old)}, {json.dumps(new)}")


def _fields(one: Store, two: Store) -> Iterator[Difference]:
    yield from _one_sided("fields", "field", one.fields, two.fields)
    for name in _common_fields(one, two, columns=False):
        ours, theirs = one.field(name).to_json(), two.field(name).to_json()
        for key, old, new in document_differences(ours, theirs):
            texts = [json.dumps(value) for value in (old, new)]
            values = f"{texts[0]}, {texts[1]}" if max(map(len, texts)) < 60 else "differ"
            yield Difference("fields", f"{key} {values}", (name,))


def _common_fields(one: Store, two: Store, *, columns: bool) -> list[str]:
    """Return the fields of both; with `columns`, those whose values can be compared."""
    names = [name for name in one.fields if name in two.fields]
    if not columns:
        return names
    same = (one.fields[n].labels == two.fields[n].labels and one.field(n).rate == two.field(n).rate for n in names)
    return [name for name, yes in zip(names, same, strict=True) if yes]


def _clips(one: Store, two: Store, common: Sequence[tuple[Clip, Clip]], atol: float | None) -> Iterator[Difference]:
    yield from _one_sided("clips", "clip", one.clips().ids, two.clips().ids)
    changed: dict[str, list[str]] = {}
    example: dict[str, str] = {}
    for ours, theirs in common:
        for key in _ABOUT_CLIP:
            old, new = getattr(ours, key), getattr(theirs, key)
            if not is_same_number(old, new, atol):
                changed.setdefault(key, []).append(ours.id)
                example.setdefault(key, f"{old!r}, {new!r}")
    for key, ids in changed.items():
        yield Difference("clips", f"{key} of {counted(len(ids), 'clip')}, e.g. {example[key]}", tuple(ids))


def _segments(one: Store, two: Store, common: Sequence[tuple[Clip, Clip]]) -> Iterator[Difference]:
    """Compare words and events; quality flags are compared as such."""
    if one.layers == two.layers == ():
        return
    ids = [ours.id for ours, theirs in common if _words(one, ours.id) != _words(two, theirs.id)]
    if ids:
        yield Difference("segments", f"segments of {counted(len(ids), 'clip')}", tuple(ids))


def _words(store: Store, clip: str) -> list[Segment]:
    return [segment for segment in store.segments(clip) if segment.layer.name != "quality"]


def _windows(one: Store, two: Store) -> Iterator[Difference]:
    starts = [_starts(store) for store in (one, two)]
    ids = tuple(clip for clip in starts[0] if clip in starts[1] and starts[0][clip] != starts[1][clip])
    if ids:
        counts = [sum(len(s[clip]) for clip in ids) for s in starts]
        yield Difference("windows", f"windows of {counted(len(ids), 'clip')}: {counts[0]}, {counts[1]}", ids)


def _starts(store: Store) -> dict[str, set[tuple[int, int]]]:
    windows = {clip.id: store[clip.id].windows() for clip in store}
    return {clip: {(w.start, w.length) for w in of_clip} for clip, of_clip in windows.items() if of_clip}


def _values(one: Store, two: Store, common: Sequence[tuple[Clip, Clip]], atol: float | None) -> Iterator[Difference]:
    shards = [{s["sha256"] for s in store.info["shards"]} for store in (one, two)]
    if shards[0] == shards[1] or one.fps != two.fps:
        return
    for name in _common_fields(one, two, columns=True):
        gap = _gap(one, two, name, common)
        if gap.other_shapes:
            message = f"{name}: other numbers of rows in {counted(len(gap.other_shapes), 'clip')}"
            yield Difference("values", message, tuple(gap.other_shapes))
        if gap.clips:
            within = atol is not None and gap.worst <= atol
            message = f"{name}: other values in {len(gap.clips)} of {len(common)} clips"
            message += f", by at most {gap.worst:.3g} ({gap.where})" + (f", within {atol:g}" if within else "")
            yield Difference("note" if within else "values", message, tuple(gap.clips), {"max_abs": gap.worst})
        elif atol is not None:
            yield Difference("note", f"{name}: the same values", numbers={"max_abs": 0.0})


@dataclass
class _Gap:
    """Differences of a field: clips with other numbers of rows, clips with other values, the largest gap."""

    other_shapes: dict[str, None] = field(default_factory=dict)
    clips: dict[str, None] = field(default_factory=dict)
    worst: float = 0.0
    where: str = ""


def _gap(one: Store, two: Store, name: str, common: Sequence[tuple[Clip, Clip]]) -> _Gap:
    largest = _Gap()
    for clip, same in common:
        rows = _clip_rows(one, clip, name), _clip_rows(two, same, name)
        if rows[0].shape != rows[1].shape:
            largest.other_shapes[clip.id] = None
        elif not np.array_equal(*rows):
            largest.clips[clip.id] = None
            gap = np.abs(rows[0].astype(np.float64) - rows[1])
            if gap.max() > largest.worst:
                largest.worst = float(gap.max())
                row, column = np.unravel_index(int(gap.argmax()), gap.shape)
                largest.where = f"row {row} of {clip.id}, column {one.fields[name].labels[column]}"
    return largest


def _clip_rows(store: Store, clip: Clip, name: str) -> npt.NDArray[Any]:
    """Return the rows of a field within a clip; none where the clip does not have it."""
    if name in clip:
        return store[clip.id].rows_within(name)[1]
    return np.empty((0, store.fields[name].width))


def _rows(
    kind: str, one: Sequence[Mapping[str, Any]], two: Sequence[Mapping[str, Any]], atol: float | None
) -> Iterator[Difference]:
    """Compare the lines of rejects.jsonl or quality.jsonl."""
    for side, only in zip(("A", "B"), unmatched(one, two, atol), strict=True):
        if only:
            names = tuple(dict.fromkeys(str(row.get("clip") or row.get("file", "")) for row in only))
            yield Difference(kind, f"{counted(len(only), 'line')} only in {side}", names)


def _one_sided(kind: str, what: str, one: Iterable[str], two: Iterable[str]) -> Iterator[Difference]:
    names = [list(one), list(two)]
    for k, side in enumerate(("A", "B")):
        other = set(names[1 - k])
        only = tuple(name for name in names[k] if name not in other)
        if only:
            yield Difference(kind, f"{counted(len(only), what)} only in {side}", only)

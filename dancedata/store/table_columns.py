"""Columns of the tables of a split: a closed list of types, and how each lies in HDF5.

Numbers are one dataset, texts are offsets and bytes, lists are offsets of entries. Columns are arrays of a mapped
file: a value is made when it is read. docs/store-format.md has the table of types.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.core.text import is_unicode, quoted
from dancedata.store import hdf5

#: Largest text, bytes, and most entries of a list.
MAX_TEXT, MAX_ENTRIES = 1 << 20, 4096
#: Missing values of free columns and times, and of truth values.
MISSING_INT, MISSING_BOOL = -(2**63), 255

Array = npt.NDArray[Any]


class Source(Protocol):
    """Gives the arrays of a table by their names."""

    def array(self, name: str, kinds: str) -> Array:
        """Return a dataset of one of these numpy kinds."""
        ...

    def error(self, name: str, problem: str, actual: object, allowed: object = None) -> StoreError:
        """Return an error that names the file and the dataset."""
        ...


class TextColumn(Sequence[str]):
    """Texts as offsets (N + 1,) into bytes (B,) of UTF-8; each is decoded on access."""

    def __init__(self, offset: Array, data: Array) -> None:
        self.offset, self._data = offset, data

    @classmethod
    def of(cls, texts: Sequence[str]) -> TextColumn:
        """Make a column of texts."""
        raw = [text.encode() for text in texts]
        offset = np.cumsum([0, *map(len, raw)], dtype=np.int64)
        return cls(offset, np.frombuffer(b"".join(raw), dtype=np.uint8))

    def __len__(self) -> int:
        return len(self.offset) - 1

    def raw(self, row: int) -> bytes:
        """Return the bytes of a text."""
        return self._data[self.offset[row] : self.offset[row + 1]].tobytes()

    @overload
    def __getitem__(self, row: int) -> str: ...

    @overload
    def __getitem__(self, row: slice) -> list[str]: ...

    def __getitem__(self, row: int | slice) -> str | list[str]:
        if isinstance(row, slice):
            begin, stop, step = row.indices(len(self))
            return list(self)[row] if step != 1 else list(self._between(begin, max(begin, stop)))
        if not -len(self) <= row < len(self):
            raise IndexError(row)
        return self.raw(row % len(self)).decode()

    def __iter__(self) -> Iterator[str]:
        return self._between(0, len(self))

    def _between(self, begin: int, stop: int) -> Iterator[str]:
        offset = self.offset[begin : stop + 1].tolist()
        data = self._data[offset[0] : offset[-1]].tobytes()
        for first, end in pairwise(offset):
            yield data[first - offset[0] : end - offset[0]].decode()

    def sorted_rows(self) -> npt.NDArray[np.int32]:
        """Return the rows (N,), sorted by the bytes of their texts."""
        raw = [self.raw(row) for row in range(len(self))]
        return np.asarray(sorted(range(len(raw)), key=raw.__getitem__), dtype=np.int32)


class ListColumn(Sequence[tuple[Any, ...]]):
    """Lists: offsets (N + 1,) into the entries, which are texts or numbers."""

    def __init__(self, begin: Array, entries: TextColumn | Array) -> None:
        self.begin, self.entries = begin, entries

    def __len__(self) -> int:
        return len(self.begin) - 1

    @overload
    def __getitem__(self, row: int) -> tuple[Any, ...]: ...

    @overload
    def __getitem__(self, row: slice) -> list[tuple[Any, ...]]: ...

    def __getitem__(self, row: int | slice) -> tuple[Any, ...] | list[tuple[Any, ...]]:
        if isinstance(row, slice):
            return [self[k] for k in range(*row.indices(len(self)))]
        values = self.entries[int(self.begin[row]) : int(self.begin[row + 1])]
        return tuple(values if isinstance(values, list) else values.tolist())


@dataclass(frozen=True)
class ColumnType:
    """A type of columns.

    `problem`: Returns why a value cannot be stored; "" if it can.
    `write`: Writes values under a name into an HDF5 group.
    `read`: Reads a column; its items are the values of the rows.
    """

    problem: Callable[[Any], str]
    write: Callable[[Any, str, Sequence[Any]], None]
    read: Callable[[Source, str], Any]


def text_problem(value: Any) -> str:
    """Return why a value cannot be stored as a text; "" if it can."""
    if not isinstance(value, str):
        return "not a text"
    if "\0" in value:
        return "a text with a NUL"
    if not is_unicode(value):
        return "a text that is not valid Unicode"
    return (
        ""
        if len(value) <= MAX_TEXT and len(value.encode()) <= MAX_TEXT
        else f"a text of more than {MAX_TEXT:,} bytes"
    )


def _list_problem(of_entry: Callable[[Any], str]) -> Callable[[Any], str]:
    def problem(value: Any) -> str:
        if isinstance(value, str) or not isinstance(value, Sequence):
            return "not a list"
        if len(value) > MAX_ENTRIES:
            return f"a list of more than {MAX_ENTRIES:,} entries"
        return next(filter(None, map(of_entry, value)), "")

    return problem


def whole_problem(value: Any, least: int = -(2**63), most: int = 2**63 - 1) -> str:
    """Return why a value cannot be stored as a whole number; "" if it can."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return "" if whole and least <= value <= most else f"not a whole number from {least} to {most}"


def _number_problem(value: Any) -> str:
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return "" if real else "not a number"


def _write_text(group: Any, name: str, values: Sequence[str]) -> None:
    column = TextColumn.of(values)
    hdf5.write_array(group, f"{name}/offset", column.offset)
    hdf5.write_array(group, f"{name}/bytes", column._data)


def _read_text(source: Source, name: str) -> TextColumn:
    offset, data = source.array(f"{name}/offset", "i"), source.array(f"{name}/bytes", "u")
    _check_offsets(source, f"{name}/offset", offset, len(data))
    return TextColumn(offset, data)


def _check_offsets(source: Source, name: str, offset: Array, n: int) -> None:
    """Check the ends; `check` looks at the others: here, only pages that are read are touched."""
    if not len(offset) or offset[0] != 0 or offset[-1] != n:
        ends = [int(offset[0]), int(offset[-1])] if len(offset) else "none"
        raise source.error(name, "offsets do not begin at 0 and end at the last entry", ends, f"0 to {n}")


def _write_list(write: Callable[[Any, str, Sequence[Any]], None]) -> Callable[[Any, str, Sequence[Any]], None]:
    def write_list(group: Any, name: str, values: Sequence[Sequence[Any]]) -> None:
        hdf5.write_array(group, f"{name}/list", np.cumsum([0, *map(len, values)], dtype=np.int64))
        write(group, name, [entry for value in values for entry in value])

    return write_list


def _texts(source: Source, name: str) -> ListColumn:
    begin, entries = source.array(f"{name}/list", "i"), _read_text(source, name)
    _check_offsets(source, f"{name}/list", begin, len(entries))
    return ListColumn(begin, entries)


def _values(source: Source, name: str) -> ListColumn:
    begin, entries = source.array(f"{name}/list", "i"), source.array(f"{name}/values", "if")
    _check_offsets(source, f"{name}/list", begin, len(entries))
    return ListColumn(begin, entries)


def _write_numbers(dtype: str, suffix: str = "") -> Callable[[Any, str, Sequence[Any]], None]:
    return lambda group, name, values: hdf5.write_array(group, name + suffix, np.asarray(values, dtype=dtype))


def _read_numbers(kinds: str) -> Callable[[Source, str], Array]:
    return lambda source, name: source.array(name, kinds)


def hash_type(n_bytes: int) -> ColumnType:
    """Return the type of hashes, (N, n_bytes) uint8, given as hexadecimal text; "" is zeros."""

    def problem(value: Any) -> str:
        good = isinstance(value, str) and (not value or len(value) == 2 * n_bytes)
        return "" if good and all(c in "0123456789abcdef" for c in value) else f"not {2 * n_bytes} hexadecimal digits"

    def write(group: Any, name: str, values: Sequence[str]) -> None:
        raw = b"".join(bytes.fromhex(value or "00" * n_bytes) for value in values)
        hdf5.write_array(group, name, np.frombuffer(raw, dtype=np.uint8).reshape(-1, n_bytes))

    def read(source: Source, name: str) -> Array:
        array = source.array(name, "u")
        if array.shape[1:] != (n_bytes,):
            raise source.error(name, "hashes of another length", array.shape, f"(N, {n_bytes})")
        return array

    return ColumnType(problem, write, read)


#: By the name in dataset.json. "int32" and "int64" are both "int" there.
TYPES: Mapping[str, ColumnType] = {
    "int": ColumnType(whole_problem, _write_numbers("<i8"), _read_numbers("i")),
    "int32": ColumnType(lambda v: whole_problem(v, -1, 2**31 - 1), _write_numbers("<i4"), _read_numbers("i")),
    "row": ColumnType(lambda v: whole_problem(v, -1, 2**31 - 1), _write_numbers("<i4"), _read_numbers("i")),
    "time": ColumnType(whole_problem, _write_numbers("<i8"), _read_numbers("i")),
    "float": ColumnType(_number_problem, _write_numbers("<f8"), _read_numbers("f")),
    "bool": ColumnType(
        lambda v: "" if isinstance(v, bool) or v == MISSING_BOOL else "not a truth value",
        _write_numbers("u1"),
        _read_numbers("u"),
    ),
    "text": ColumnType(text_problem, _write_text, _read_text),
    "texts": ColumnType(_list_problem(text_problem), _write_list(_write_text), _texts),
    "ints": ColumnType(_list_problem(whole_problem), _write_list(_write_numbers("<i8", "/values")), _values),
    "floats": ColumnType(_list_problem(_number_problem), _write_list(_write_numbers("<f8", "/values")), _values),
    "hash:18": hash_type(18),
    "hash:32": hash_type(32),
}
#: Values of a free column where a clip has none.
MISSING: Mapping[str, Any] = {
    "int": MISSING_INT, "float": float("nan"), "bool": MISSING_BOOL, "text": "",
    "texts": (), "ints": (), "floats": (),
}  # fmt: skip


def type_of(name: str) -> ColumnType:
    """Return a type by its name in dataset.json; KeyError for an unknown one."""
    return TYPES["row" if name.startswith("row:") else name]


def free_type(values: Sequence[Any]) -> str:
    """Return the type of a free column by its values that are there.

    Raises StoreError: for values of several types, or of none that tables hold.
    """
    kinds = dict.fromkeys(_kind(value) for value in values)
    kinds.pop("empty", None)
    if set(kinds) == {"int", "float"}:
        return "float"
    if set(kinds) == {"ints", "floats"}:
        return "floats"
    if len(kinds) > 1 or "" in kinds:
        shown = next((value for value in values if not _kind(value)), values[0])
        raise StoreError(
            "a free column holds values of several types, or of a type that tables do not have",
            found=f"{', '.join(kind or 'another' for kind in kinds)}, such as {quoted(shown)}",
            allowed="text, truth values, whole or real numbers, or lists of texts or numbers",
        )
    return next(iter(kinds), "texts")


def _kind(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        kinds = {_kind(entry) for entry in value}
        if kinds <= {"int", "float"} and kinds:
            return "floats" if "float" in kinds else "ints"
        return "texts" if kinds == {"text"} else "" if kinds else "empty"
    if isinstance(value, str):
        return "text"
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, (int, np.integer)):
        return "int"
    return "float" if isinstance(value, (float, np.floating)) else ""

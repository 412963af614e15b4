"""Columns of tables as they lie in HDF5: numbers, texts, and lists of either. docs/reference/store.md has the page.

A column of numbers or texts is one dataset (N,), a list is a group: `offset` (N + 1,) into its `values`. Texts are
HDF5's strings of fixed length; if one has more than 128 bytes, lists of their bytes. HDF5's strings of variable
length are not used: a damaged heap makes the library hang.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.core.text import is_unicode, quoted
from dancedata.store import hdf5

#: Largest text, bytes, and most entries of a list.
MAX_TEXT, MAX_ENTRIES = 1 << 20, 4096
#: Most rows of a table.
MAX_ROWS = 2**31 - 1
#: Longer texts are lists of bytes.
FIXED = 128
#: Values of free columns where a clip has none; the attribute `_FillValue` of numbers repeats them.
MISSING: Mapping[str, Any] = {
    "int": -(2**63), "float": float("nan"), "bool": 255, "text": "", "texts": (), "ints": (), "floats": (),
}  # fmt: skip
_DTYPES = {"int": "<i8", "int32": "<i4", "float": "<f8", "bool": "u1"}
Array = npt.NDArray[Any]


class Texts(Sequence[str]):
    """Texts, decoded on access: (N,) bytes of fixed length, or offsets (N + 1,) into bytes."""

    def __init__(self, values: Array, offset: Array | None = None, where: str = "") -> None:
        self._values, self.offset, self._where = values, offset, where

    @property
    def values(self) -> Array:
        """(N,) texts as bytes; of any length as objects."""
        return self._values if self.offset is None else np.array(list(map(self._raw, range(len(self)))), dtype=object)

    def _raw(self, row: int) -> bytes:
        if self.offset is None:
            raw: bytes = self._values[row]
            return raw
        if not -len(self) <= row < len(self):
            raise IndexError(row)
        return self._values[between(self.offset, row % len(self), len(self._values), self._where)].tobytes()

    def _decoded(self, raw: Iterable[bytes]) -> list[str]:
        try:
            return [text.decode() for text in raw]
        except UnicodeDecodeError as error:
            raise broken(self._where, "a text that is not valid UTF-8", quoted(error.object[:60])) from error

    def __len__(self) -> int:
        return len(self._values) if self.offset is None else len(self.offset) - 1

    @overload
    def __getitem__(self, row: int) -> str: ...

    @overload
    def __getitem__(self, row: slice | Sequence[int]) -> list[str]: ...

    def __getitem__(self, row: int | slice | Sequence[int]) -> str | list[str]:
        if not isinstance(row, (slice, Sequence)):
            return self._decoded((self._raw(row),))[0]
        if self.offset is None:
            return self._decoded(self._values[row].tolist())
        rows = range(*row.indices(len(self))) if isinstance(row, slice) else row
        return self._decoded(map(self._raw, rows))

    def __iter__(self) -> Iterator[str]:
        return iter(self._decoded(self.values.tolist()))

    def distinct(self) -> set[str]:
        """Return the different texts."""
        return set(self._decoded(set(self.values.tolist())))

    def isin(self, texts: Iterable[str]) -> npt.NDArray[np.bool_]:
        """Return which of the texts (N,) are one of some texts."""
        return np.isin(self.values, [text.encode() for text in texts])


class Lists(Sequence[tuple[Any, ...]]):
    """Lists: offsets (N + 1,) into values, which are texts or numbers."""

    def __init__(self, offset: Array, values: Texts | Array, where: str = "") -> None:
        self.offset, self.values, self._where = offset, values, where

    def __len__(self) -> int:
        return len(self.offset) - 1

    @overload
    def __getitem__(self, row: int) -> tuple[Any, ...]: ...

    @overload
    def __getitem__(self, row: slice) -> list[tuple[Any, ...]]: ...

    def __getitem__(self, row: int | slice) -> tuple[Any, ...] | list[tuple[Any, ...]]:
        if isinstance(row, slice):
            return [self[k] for k in range(*row.indices(len(self)))]
        values = self.values[between(self.offset, row, len(self.values), self._where)]
        return tuple(values if isinstance(values, list) else values.tolist())


def between(offset: Array, row: int, n: int, where: str) -> slice:
    """Return the entries of a row by offsets (N + 1,) into `n` values; StoreError for a row beyond them."""
    begin, end = int(offset[row]), int(offset[row + 1])
    if not 0 <= begin <= end <= n:
        raise broken(
            f"{where}/offset", "offsets that do not ascend within the values", f"{begin}, {end}", f"0 to {n}"
        )
    return slice(begin, end)


def broken(where: str, problem: str, actual: object, allowed: object = None) -> StoreError:
    """Return the error of a table that does not fit its dataset."""
    return StoreError(problem, where=where, found=actual, allowed=allowed, fix="run dancedata check on the dataset")


def require_within(where: str, columns: Mapping[str, Any], bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raise StoreError for a number of a table beyond the bounds of its column, and nan; not all have to be there."""
    for name, (least, most) in bounds.items():
        column = np.asarray(columns.get(name, ()))
        if column.size and not (least <= column.min() and column.max() <= most):
            row = int(np.argmin((least <= column) & (column <= most)))
            actual, allowed = f"{column[row]} in row {row}", f"{least:.15g} to {most:.15g}"
            raise broken(f"{where}/{name}", "a number is out of bounds", actual, allowed)


Column = Array | Texts | Lists


def checked(name: str, kind: str, values: Sequence[Any]) -> Sequence[Any]:
    """Return the values of a column; StoreError for one that it cannot hold."""
    wrong = next(filter(None, (problem(kind, value) for value in values)), "")
    if wrong:
        raise StoreError(f"a value of a table cannot be stored: {wrong}", where=name)
    return values


def write_column(group: Any, name: str, kind: str, values: Sequence[Any], *, nullable: bool = False) -> None:
    """Write the values of a column, which are those of `checked`."""
    if kind == "text":
        hdf5.write_strings(group, name, values, FIXED)
    elif kind in ("texts", "ints", "floats"):
        hdf5.write_array(group, f"{name}/offset", np.cumsum([0, *map(len, values)], dtype=np.int64))
        write_column(group, f"{name}/values", kind[:-1], [entry for value in values for entry in value])
    else:
        hdf5.write_array(group, name, np.asarray(values, dtype=_DTYPES[kind]))
        if nullable:
            group[name].attrs["_FillValue"] = np.asarray(MISSING[kind], dtype=_DTYPES[kind])


def problem(kind: str, value: Any) -> str:
    """Return why a value cannot be stored in a column of a kind; "" if it can."""
    if kind == "text":
        return text_problem(value)
    if kind == "bool":
        return "" if isinstance(value, bool) or value == MISSING["bool"] else "not a truth value"
    if kind == "float":
        real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        return "" if real else "not a number"
    if kind in ("int", "int32"):
        return whole_problem(value, *((-1, 2**31 - 1) if kind == "int32" else ()))
    if isinstance(value, str) or not isinstance(value, Sequence):
        return "not a list"
    if len(value) > MAX_ENTRIES:
        return f"a list of more than {MAX_ENTRIES:,} entries"
    return next(filter(None, (problem(kind[:-1], entry) for entry in value)), "")


def text_problem(value: Any) -> str:
    """Return why a value cannot be stored as a text; "" if it can."""
    if not isinstance(value, str):
        return "not a text"
    if "\0" in value:
        return "a text with a NUL"
    if not is_unicode(value):
        return "a text that is not valid Unicode"
    long = len(value) > MAX_TEXT or len(value.encode()) > MAX_TEXT
    return f"a text of more than {MAX_TEXT:,} bytes" if long else ""


def whole_problem(value: Any, least: int = -(2**63), most: int = 2**63 - 1) -> str:
    """Return why a value cannot be stored as a whole number; "" if it can."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return "" if whole and least <= value <= most else f"not a whole number from {least} to {most}"


def kind_of(column: Column) -> str:
    """Return the kind of values that a column holds."""
    if isinstance(column, Lists):
        return f"{kind_of(column.values)}s"
    if isinstance(column, Texts):
        return "text"
    return {"i": "int", "u": "bool", "f": "float"}[column.dtype.kind]


def free_kind(values: Sequence[Any]) -> str:
    """Return the kind of a free column by its values; StoreError for several kinds, or one that is not stored."""
    kinds = dict.fromkeys(map(_kind, values))
    kinds.pop("empty", None)
    if set(kinds) in ({"int", "float"}, {"ints", "floats"}):
        return max(kinds, key=lambda kind: kind.startswith("float"))
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

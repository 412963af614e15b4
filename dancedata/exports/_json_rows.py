"""Rows of numbers as JSON, short and exact for float32."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt


def json_of(name: str, arrays: Mapping[str, npt.NDArray[np.float32]]) -> bytes:
    """Return ``{"id": name, KEY: rows, ...}``: nine digits, which give back every float32."""
    parts = [f'"id": {json.dumps(name)}', *(f'"{key}": {"".join(_rows(rows))}' for key, rows in arrays.items())]
    return f"{{{', '.join(parts)}}}\n".encode()


def _rows(rows: npt.NDArray[np.float32]) -> Iterator[str]:
    # Whole numbers alone would be read as an array of integers.
    digits = "%.1f" if np.array_equal(rows, np.trunc(rows)) else "%.9g"
    line = f"[{','.join([digits] * rows.shape[1])}]"
    yield "["
    for number, row in enumerate(rows.tolist()):
        yield f",\n{line % tuple(row)}" if number else line % tuple(row)
    yield "]"

"""Untrusted JSON, parsed within bounds; every failure is a ValueError."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from dancedata.files.regular_file import read_regular

#: Far more than the nesting of any document of dancedata. Recursive code would exhaust the stack on deeper ones.
MAX_DEPTH = 64


def parse_json(text: str, pairs: Callable[[list[tuple[str, Any]]], Any] | None = None) -> Any:
    """Parse a JSON document; `pairs` creates an object from its keys and values."""
    try:
        document = json.loads(text, object_pairs_hook=pairs, parse_constant=_no_constant, parse_float=_finite)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    level = [document]
    for _ in range(MAX_DEPTH + 1):
        level = [
            inner
            for outer in level
            if isinstance(outer, dict | list)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, dict | list)
        ]
        if not level:
            return document
    raise ValueError(f"it is nested deeper than {MAX_DEPTH} levels")


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:40]} is out of range")
    return number


def read_json(path: Path, limit: int) -> Any:
    """Read a JSON file of at most `limit` bytes."""
    return parse_json(read_regular(path, limit).decode("utf-8-sig"))

"""Errors as tests expect them: by class, place, reason and a word that teaches. The rest of the wording is free."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from dancedata.core.errors import DataError

E = TypeVar("E", bound=BaseException)


@contextmanager
def raises_message(
    error: type[E], word: str, *, where: str = "", reason: str | None = None
) -> Iterator[pytest.ExceptionInfo[E]]:
    """Expect an error with `word`, a regular expression of any case, in its text; its place ends with `where`."""
    __tracebackhide__ = True
    with pytest.raises(error, match=re.compile(word, re.IGNORECASE)) as caught:
        yield caught
    assert str(getattr(caught.value, "where", "")).endswith(where), f"another place: {caught.value}"
    assert reason in (None, getattr(caught.value, "reason", None)), f"another reason: {caught.value}"


def refused_file(read: Callable[[Path], Any], path: Path, data: bytes, reason: str) -> str:
    """Write a file and expect `read` to refuse it by name, with a reason; return the message."""
    path.write_bytes(data)
    with raises_message(DataError, "", reason=reason) as error:
        read(path)
    assert str(path) in str(error.value)
    return str(error.value)

"""The errors of dancedata. Each says where, what was found, what is allowed and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

from dancedata.core.nearest import closest
from dancedata.core.text import listed, printable, shown

#: Characters of a path that a message shows: all that a file system takes.
_MAX_WHERE = 4400
#: Characters of every other part of a message: lists of all problems of a recipe are the longest.
_MAX_PART = 20_000
#: Known names that a message lists: all joints of a skeleton, not all clips of a dataset.
_LISTED = 60


class DanceDataError(Exception):
    """Base of all errors that dancedata raises on purpose.

    Parameters
    ----------
    problem
        What is wrong, in one clause.
    where
        File, clip, frame or key that it is about.
    found, allowed
        What was there and what may be there.
    fix
        What to do about it.
    """

    #: Characters of what was found that the text shows, and whether it may have several lines.
    limit: ClassVar[int] = _MAX_PART
    lines: ClassVar[bool] = True

    def __init__(
        self,
        problem: str,
        *,
        where: object = None,
        found: object = None,
        allowed: object = None,
        fix: str | None = None,
    ) -> None:
        super().__init__(problem)
        self.problem = problem
        self.where = where
        self.found = found
        self.allowed = allowed
        self.fix = fix

    def __str__(self) -> str:
        """Join the parts into one readable text; what does not print is written as backslash sequences."""
        text = self._part(self.problem, _MAX_PART, lines=True)
        if self.where is not None:
            text = f"{shown(self.where, _MAX_WHERE)}: {text}"
        if self.found is not None:
            text += f"; found {self._part(self.found, self.limit, self.lines)}"
        if self.allowed is not None:
            text += f"; allowed: {self._part(self.allowed, self.limit, self.lines)}"
        if self.fix:
            fix = self._part(self.fix, _MAX_PART, self.lines)
            # A sentence begins with a capital, a file name, key or command keeps its own.
            first = fix.split(maxsplit=1)[0]
            fix = f"{fix[:1].upper()}{fix[1:]}" if first.rstrip(",:").isalpha() and first != "dancedata" else fix
            # A list, one entry a line, is followed by a line of its own.
            text += fix if text.endswith("\n") else f". {fix}"
        return text

    @staticmethod
    def _part(value: object, limit: int, lines: bool) -> str:
        if not isinstance(value, str):
            return shown(value)
        return printable(value if len(value) <= limit else f"{value[:limit]}...", lines=lines)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle with all parts, so that errors survive the way back from a worker process."""
        return _rebuild, (type(self), self.problem, dict(self.__dict__))


def _rebuild(cls: type[DanceDataError], problem: str, state: dict[str, object]) -> DanceDataError:
    error = cls.__new__(cls)
    Exception.__init__(error, problem)
    error.__dict__.update(state)
    return error


class UsageError(DanceDataError):
    """Something was asked for that does not exist or makes no sense (exit code 2)."""


class RecipeError(UsageError):
    """A recipe is wrong; lists every problem at once."""


class SourceError(DanceDataError):
    """A source folder as a whole cannot be used."""


class StoreError(DanceDataError):
    """A built dataset is missing, incomplete, damaged, or of another version or recipe."""


class DataError(DanceDataError):
    """One file or clip is bad. It is set aside and the build goes on.

    Parameters
    ----------
    reason
        Code that rejects.jsonl counts by, such as "nan" or "broken_file".
    """

    # It is about a file that others made, and becomes a line of rejects.jsonl.
    limit = 600
    lines = False

    def __init__(
        self,
        problem: str,
        *,
        reason: str,
        where: object = None,
        found: object = None,
        allowed: object = None,
        fix: str | None = None,
    ) -> None:
        super().__init__(problem, where=where, found=found, allowed=allowed, fix=fix)
        self.reason = reason


def did_you_mean(name: str, known: Iterable[str], also: Iterable[str] = ()) -> str:
    """Return "did you mean 'x'? known: a, b, c" for a misspelt name; names may come from files.

    Parameters
    ----------
    also
        Names that may be meant and are not listed.
    """
    names = [shown(k) for k in known]
    close = closest(shown(name), [*names, *also])
    known_names = f"known: {listed(names, _LISTED)}" if names else "none is known"
    return f"did you mean {close!r}? {known_names}" if close is not None else known_names

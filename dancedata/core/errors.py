"""The errors of dancedata. Each says where, what was found, what is allowed and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable

from dancedata.core.nearest import closest

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
        """Join the parts into one readable text."""
        text = f"{self.where}: {self.problem}" if self.where is not None else self.problem
        if self.found is not None:
            text += f"; found {self.found}"
        if self.allowed is not None:
            text += f"; allowed: {self.allowed}"
        if self.fix:
            # A sentence begins with a capital, a file name or key keeps its own.
            first = self.fix.split(maxsplit=1)[0]
            fix = f"{self.fix[:1].upper()}{self.fix[1:]}" if first.rstrip(",:").isalpha() else self.fix
            # A list, one entry a line, is followed by a line of its own.
            text += fix if text.endswith("\n") else f". {fix}"
        return text

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
    """Return "did you mean 'x'? known: a, b, c" for a misspelt name.

    Parameters
    ----------
    also
        Names that may be meant and are not listed.
    """
    names = [str(k) for k in known]
    close = closest(str(name), [*names, *also])
    more = f" and {len(names) - _LISTED:,} more" if len(names) > _LISTED else ""
    listed = f"known: {', '.join(names[:_LISTED])}{more}" if names else "none is known"
    return f"did you mean {close!r}? {listed}" if close is not None else listed

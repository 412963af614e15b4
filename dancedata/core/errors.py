"""The errors of dancedata. Each has a place, the found and the allowed values, and a fix."""

import difflib
import re
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

from dancedata.core.text import counted, listed, printable, shown

#: Most characters of a path in a message: the longest path of a file system.
_MAX_WHERE = 4400
#: Most characters of every other part of a message; lists of all problems of a recipe are the longest.
_MAX_PART = 20_000
_COMMANDS = {"dancedata", "ffmpeg", "mv", "pip"}
#: Most known names in a message: all joints of a skeleton, but not all clips of a dataset.
_LISTED = 60
#: Clips of a dataset whose names are all shown, and names shown of more.
_FEW, _NEAREST = 12, 3
#: Most characters of a name that are compared, and least of a part: shorter ones are too frequent to count.
_LONGEST, _MIN_PART = 100, 3
# Letters and digits are separate parts: "edge" of "edge151".
_PARTS = re.compile(r"[^\W\d_]+|\d+")


class DanceDataError(Exception):
    """Base of all errors that dancedata raises.

    Parameters
    ----------
    problem
        The problem, in one clause.
    where
        File, clip, frame or key with the problem.
    found, allowed
        The actual and the allowed value.
    fix
        What to do about it.
    options
        The same by the options of commands, which they print, where `fix` names arguments of Python.
    reason
        Code in JSON, such as "wrong_rate"; "": that of the class.
    """

    #: Most characters of the found value in the text, and whether it may have several lines.
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
        options: str | None = None,
        reason: str = "",
    ) -> None:
        super().__init__(problem)
        self.problem = problem
        self.reason = reason
        self.where = where
        self.found = found
        self.allowed = allowed
        self.fix = fix
        self.options = options

    def __str__(self) -> str:
        text = self._part(self.problem, _MAX_PART, lines=True)
        if self.where is not None:
            text = f"{shown(self.where, _MAX_WHERE)}: {text}"
        if self.found is not None:
            text += f"; found {self._part(self.found, self.limit, self.lines)}"
        if self.allowed is not None:
            text += f"; allowed: {self._part(self.allowed, self.limit, self.lines)}"
        if self.fix:
            fix = self._part(self.fix, _MAX_PART, self.lines)
            # Capitalised as a sentence, unless it begins with a file name, key or command.
            first = fix.split(maxsplit=1)[0]
            fix = f"{fix[:1].upper()}{fix[1:]}" if first.rstrip(",:").isalpha() and first not in _COMMANDS else fix
            # After a list with one entry per line it has its own line.
            text += fix if text.endswith("\n") else f". {fix}"
        return text

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data: `kind` "usage" or "data", `code`, and the parts of the message."""
        code = self.reason or type(self).__name__.removesuffix("Error").lower()
        parts = {"where": self.where, "found": self.found, "allowed": self.allowed, "fix": self.fix}
        texts = {name: None if value is None else str(value) for name, value in parts.items()}
        kind = "usage" if isinstance(self, UsageError) else "data"
        return {"kind": kind, "code": code, "problem": self.problem, **texts}

    @staticmethod
    def _part(value: object, limit: int, lines: bool) -> str:
        if not isinstance(value, str):
            return shown(value)
        return printable(value if len(value) <= limit else f"{value[:limit]}...", lines=lines)

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.problem, dict(self.__dict__))


def _rebuild(cls: type[DanceDataError], problem: str, state: dict[str, object]) -> DanceDataError:
    error = cls.__new__(cls)
    Exception.__init__(error, problem)
    error.__dict__.update(state)
    return error


class UsageError(DanceDataError):
    """A request is invalid or refers to something that does not exist (exit code 2)."""


class RecipeError(UsageError):
    """A recipe is invalid; lists all its problems."""


class SourceError(DanceDataError):
    """The source folder as a whole is unusable."""


class StoreError(DanceDataError):
    """A built dataset is missing, incomplete, damaged, or of another version or recipe."""


def unwritable_name(error: UnicodeEncodeError) -> StoreError:
    """Return the error for a name that Python cannot write: that of a file, where the locale is not UTF-8."""
    return StoreError(f"a name cannot be written in this locale, whose encoding is {error.encoding}",
                      found=shown(error.object),
                      fix="run it in a UTF-8 locale (LC_ALL=C.UTF-8), or set PYTHONUTF8=1")  # fmt: skip


class DataError(DanceDataError):
    """One file or clip is unusable. It is left out and the build continues.

    Parameters
    ----------
    reason
        Code in rejects.jsonl, such as "nan" or "broken_file".
    """

    # It concerns an untrusted file, and becomes a line of rejects.jsonl.
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
        options: str | None = None,
    ) -> None:
        super().__init__(problem, where=where, found=found, allowed=allowed, fix=fix, options=options, reason=reason)


@contextmanager
def error_note(what: str) -> Iterator[None]:
    """Add to an error of another kind, such as a mistake in a plug-in, what was being done."""
    try:
        yield
    except DanceDataError:
        raise
    except Exception as error:
        error.add_note(what)
        raise


def did_you_mean(name: str, known: Iterable[str], also: Iterable[str] = ()) -> str:
    """Return "did you mean 'x'? known: a, b, c" for a misspelt name; `also` are candidates that are not listed."""
    names = [shown(k) for k in known]
    close = closest(shown(name), [*names, *also])
    known_names = f"known: {listed(names, _LISTED)}" if names else "none is known"
    return f"did you mean {close!r}? {known_names}" if close is not None else known_names


def nearest(name: str, known: Iterable[str], noun: str, dataset: object) -> str:
    """Return the three most similar of many names, those of a `noun` of a dataset's folder; of few names all."""
    names, query = list(map(shown, known)), shown(name)
    if len(names) <= _FEW:
        return did_you_mean(name, names)
    first = [match for match in [closest(query, names)] if match is not None]
    others = difflib.get_close_matches(query, set(names).difference(first), _NEAREST, 0.0)
    near = ", ".join([*first, *others][:_NEAREST])
    listing = f"dancedata info {shlex.quote(shown(dataset))} --clips"
    return f"the nearest names: {near}; {counted(len(names), noun)} in all: {listing}"


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the most similar of the known names, by case, separators and parts; None if none is similar."""
    query = "".join(_parts(name))
    whole: dict[str, str] = {}
    partly: dict[str, str] = {}
    for candidate in sorted(known, key=len):  # of several names with the part, the shortest is preferred
        parts = _parts(candidate)
        plain = "".join(parts)
        whole.setdefault(plain, candidate)
        ends = ["".join(parts[k:]) for k in range(1, len(parts))]
        for part in [query] if plain.startswith(query) else [*parts, *ends]:
            if len(part) >= _MIN_PART:
                partly.setdefault(part, candidate)
    for names, cutoff in ((whole, 0.8), (partly, 0.75), (whole, 0.6)):
        if query and (match := difflib.get_close_matches(query, names, 1, cutoff)):
            return names[match[0]]
    return None


def _parts(name: str) -> list[str]:
    # "aistpp" is a common spelling of "aist++".
    return _PARTS.findall(name[:_LONGEST].lower().replace("+", "p"))

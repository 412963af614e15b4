"""Parses the hierarchy of a BVH file: joints, offsets and channels; errors name the line."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from dancedata.core.errors import DataError, did_you_mean
from dancedata.core.text import quoted, shown

_MAX_JOINTS = 1000
#: Characters of a joint's name.
MAX_NAME = 200
#: Bound of lengths and angles.
MAX_VALUE = 1e7
NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
POSITIONS = ("Xposition", "Yposition", "Zposition")
ROTATIONS = ("Xrotation", "Yrotation", "Zrotation")
KEYWORDS = ("HIERARCHY", "ROOT", "JOINT", "End Site", "OFFSET", "CHANNELS", "MOTION", "{", "}")


@dataclass(frozen=True)
class BvhJoint:
    """A joint of the hierarchy, after its parent (index, -1 for the root); names need not be unique.

    `offset`: (3,) from the parent, in the file's unit. `first`: Column of the first channel.
    """

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]
    first: int
    line: int

    @property
    def order(self) -> str:
        """Axes of the rotation channels in their order, such as "ZYX"; "" for a joint without any."""
        return "".join(c[0] for c in self.channels if c in ROTATIONS)

    @property
    def rotation_columns(self) -> list[int]:
        """Columns of the rotation channels."""
        return [self.first + k for k, c in enumerate(self.channels) if c in ROTATIONS]

    @property
    def position_columns(self) -> dict[int, int]:
        """Columns of the position channels by axis, 0 to 2."""
        return {POSITIONS.index(c): self.first + k for k, c in enumerate(self.channels) if c in POSITIONS}


def bvh_error(
    path: Path,
    line: int,
    problem: str,
    found: object = None,
    allowed: object = None,
    fix: str = "export the file again",
    *,
    reason: str = "broken_file",
) -> DataError:
    """Return a DataError about a line of a file."""
    return DataError(problem, reason=reason, where=f"{path}, line {line}", found=found, allowed=allowed, fix=fix)


def parse_hierarchy(path: Path, lines: Sequence[bytes]) -> tuple[tuple[BvhJoint, ...], int]:
    """Return the joints in the file's order, and the number of the line with MOTION; DataError with the line."""
    hierarchy = _Hierarchy(path)
    for line, text in _statements(lines):
        if hierarchy.take(line, text):
            return hierarchy.finished(), line
    raise bvh_error(path, max(len(lines), 1), "the file ends before MOTION", reason="truncated")


def not_a_number(path: Path, line: int, word: bytes) -> DataError:
    """Return the DataError for a word that is not a usable number."""
    found = quoted(word[:40].decode("utf-8", "replace"))
    if word.lower().strip(b"+-") in (b"nan", b"inf", b"infinity", b"1.#qnan", b"1.#ind", b"1.#inf"):
        return bvh_error(path, line, "a value is not finite", found, "finite numbers", reason="nan")
    fix = "write decimal points instead of commas" if b"," in word else "export the file again"
    return bvh_error(path, line, "a value is not a number", found, "numbers such as -12.5", fix=fix)


def _statements(lines: Sequence[bytes]) -> Iterator[tuple[int, str]]:
    for k, line in enumerate(lines, start=1):
        for part in re.split(r"([{}])", line.decode("utf-8", "replace")):
            if part.strip():
                yield k, part.strip()


@dataclass
class _Draft:
    """A joint or an End Site while its block is parsed."""

    name: str
    parent: int
    line: int
    index: int = -1
    is_end: bool = False
    offset: tuple[float, float, float] | None = None
    channels: tuple[str, ...] | None = None


class _Hierarchy:
    """Parses the statements up to MOTION; `joints` are in the file's order."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.joints: list[_Draft] = []
        self._open: list[_Draft] = []
        self._next: _Draft | None = None
        self._line = 0
        self._bad = partial(bvh_error, path, 0)

    def take(self, line: int, text: str) -> bool:
        """Parse a statement; return True for MOTION."""
        self._line, self._bad = line, partial(bvh_error, self.path, line)
        word, rest = (*text.split(maxsplit=1), "")[:2]
        kind = word.upper()
        if self._next is not None and kind != "{":
            raise self._bad(f"{self._next.name} has no block", text, "{")
        if kind in ("ROOT", "JOINT") or kind.startswith("END"):
            self._declare(kind, rest)
        elif kind == "{":
            self._begin()
        elif kind == "}":
            self._end()
        elif kind == "OFFSET":
            self._offset(rest)
        elif kind == "CHANNELS":
            self._channels(rest)
        elif kind == "MOTION":
            self._finish()
            return True
        elif kind != "HIERARCHY":
            raise self._bad(f"unknown keyword {word[:40]!r}", allowed=did_you_mean(word[:40], KEYWORDS))
        return False

    def finished(self) -> tuple[BvhJoint, ...]:
        """Return the joints with their columns."""
        joints, first = [], 0
        for draft in self.joints:
            channels = draft.channels or ()
            joints.append(BvhJoint(draft.name, draft.parent, draft.offset or (0, 0, 0), channels, first, draft.line))
            first += len(channels)
        return tuple(joints)

    def _declare(self, kind: str, name: str) -> None:
        parent = self._open[-1] if self._open else None
        if kind == "ROOT" and self.joints:
            raise self._bad("a second skeleton begins", f"ROOT {shown(name)}", "one skeleton per file",
                            "write one file per person")  # fmt: skip
        if kind != "ROOT" and (parent is None or parent.is_end):
            raise self._bad(
                f"{kind[:40]} {shown(name)} is outside of a joint", allowed="ROOT first, joints within it"
            )
        above = -1 if parent is None else parent.index
        if kind.startswith("END"):
            self._next = _Draft("End Site", above, self._line, is_end=True)
            return
        if not name:
            raise self._bad(f"a {kind} has no name")
        if len(name) > MAX_NAME:
            raise self._bad(f"the name of a {kind} is too long", shown(name, 60), f"at most {MAX_NAME} characters")
        if len(self.joints) >= _MAX_JOINTS:
            raise self._bad("too many joints", f"more than {_MAX_JOINTS}", f"at most {_MAX_JOINTS:,}")
        self._next = _Draft(name, above, self._line, index=len(self.joints))
        self.joints.append(self._next)

    def _begin(self) -> None:
        if self._next is None:
            raise self._bad("a block without a joint", "{", "ROOT, JOINT or End Site before it")
        self._open.append(self._next)
        self._next = None

    def _end(self) -> None:
        if not self._open:
            raise self._bad("unexpected end of a block", "}")
        done = self._open.pop()
        if done.offset is None:
            raise self._bad(f"{done.name} (line {done.line}) has no OFFSET", allowed="OFFSET x y z")
        if done.channels is None and not done.is_end:
            raise self._bad(f"joint {done.name} (line {done.line}) has no CHANNELS",
                            allowed="for example CHANNELS 3 Zrotation Xrotation Yrotation, or CHANNELS 0",
                            reason="missing_channels")  # fmt: skip

    def _current(self, what: str) -> _Draft:
        if not self._open:
            raise self._bad(f"{what} outside of a joint")
        return self._open[-1]

    def _offset(self, rest: str) -> None:
        joint = self._current("OFFSET")
        if joint.offset is not None:
            raise self._bad(f"{joint.name} has two OFFSETs")
        words = rest.split()
        if len(words) != 3:
            raise self._bad("OFFSET requires three numbers", f"{len(words)}", "OFFSET x y z")
        for word in words:
            if not NUMBER.fullmatch(word.encode()):
                raise not_a_number(self.path, self._line, word.encode())
        x, y, z = (float(word) for word in words)
        if not max(abs(x), abs(y), abs(z)) <= MAX_VALUE:
            raise self._bad("an OFFSET is out of range", rest[:80], f"numbers within +-{MAX_VALUE:g}")
        joint.offset = (x, y, z)

    def _channels(self, rest: str) -> None:
        joint = self._current("CHANNELS")
        words = rest.split()
        if joint.is_end:
            raise self._bad("an End Site has no channels")
        if joint.channels is not None:
            raise self._bad(f"{joint.name} has two lines of CHANNELS")
        if not words or not words[0].isdecimal() or words[0] != str(len(words) - 1):
            n, names = (words[0][:20] if words else "nothing"), len(words) - 1
            raise self._bad("the number in CHANNELS differs from the number of names",
                            f"{n}, but {max(names, 0)} names", "the number of channels, then their names",
                            reason="missing_channels")  # fmt: skip
        channels_by_name = {name.lower(): name for name in (*POSITIONS, *ROTATIONS)}
        channels = tuple(channels_by_name.get(word.lower(), "") for word in words[1:])
        if "" in channels:
            wrong = words[1 + channels.index("")][:40]
            raise self._bad(f"unknown channel {wrong!r}", allowed=did_you_mean(wrong, channels_by_name.values()))
        if len(set(channels)) < len(channels):
            raise self._bad("duplicate channel", rest[:120])
        joint.channels = channels

    def _finish(self) -> None:
        if self._open:
            raise self._bad(f"the block of {self._open[-1].name} (line {self._open[-1].line}) never ends")
        if not self.joints:
            raise self._bad("the hierarchy has no joints", allowed="ROOT and its joints")

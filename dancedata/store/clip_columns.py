"""CLIP_COLUMNS: the columns of the table /clips, which writer, reader, check, diff and reports loop over.

A new attribute needs a field of `ClipRecord` and a row of `CLIP_COLUMNS`. Older readers show and ignore it.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from dancedata.core.clip import ColumnValue
from dancedata.core.errors import StoreError
from dancedata.core.text import shown
from dancedata.store.columns import problem as problem_of
from dancedata.store.columns import text_problem, whole_problem

_FRACTION = re.compile(r"-?[0-9]{1,40}(/[1-9][0-9]{0,39})?")
#: Largest tempo and height: a source's values in wrong units are stored, damaged numbers are not.
_MOST = 1_000_000


@dataclass(frozen=True, kw_only=True)
class ClipRecord:
    """A clip's row of the table /clips, without its arrays; attributes that are not listed are those of `ClipRef`.

    Attributes
    ----------
    id, split
        Name of the clip, unique in the store, and its split; shards hold one split each, so it is not a column.
    n_frames
        Frames at the store's fps.
    genre, music, dancer
        As the dataset names them; empty if unknown.
    source
        Id of the clip that this one is a copy of, else empty.
    n_flags
        Number of quality flags raised for the clip; `Store.quality` has them.
    trim_start
        First frame, at the store's fps, that belongs to the dance: according to the source, earlier ones should be
        cut. They are stored; readers skip them when trimming is requested.
    height_m
        Vertical extent of the dancer's joints, median over frames, metres; None if unknown.
    source_rate
        Frames per second of the source, as text; empty if unknown.
    song
        Id of the decoded signal in the table of songs; "" if none is recorded.
    slice_of, slice_start
        For a slice, whose rows were computed from it alone: name of its clip, and the slice's first frame in it.
    licence
        Number of its terms in `Store.licences`; -1 for those of the dataset.
    made_of
        First 12 digits of the hashes of motion file, decoded music and metadata, 36 in all; "" if not recorded.
    columns
        Free columns, by name without the prefix "x/".
    """

    id: str
    split: str
    n_frames: int
    genre: str = ""
    music: str = ""
    dancer: str = ""
    tempo_bpm: float | None = None
    source: str = ""
    n_flags: int = 0
    trim_start: int = 0
    height_m: float | None = None
    source_rate: str = ""
    lists: tuple[str, ...] = ()
    group: str = ""
    member: int = -1
    role: str = ""
    song: str = ""
    slice_of: str = ""
    slice_start: int = 0
    source_start: Fraction | None = None
    source_end: Fraction | None = None
    audio_start: Fraction = Fraction(0)
    audio_start_by: str = ""
    licence: int = -1
    made_of: str = ""
    columns: Mapping[str, ColumnValue] = field(default_factory=dict)

    @property
    def original(self) -> str:
        """Id of the source's clip: the one that this is a copy or a slice of, or this one."""
        return self.slice_of or self.source or self.id

    @property
    def recording(self) -> str:
        """What counts once in intervals: this clip (not a copy), or what slices or parts of a file share."""
        if self.slice_of:
            return self.slice_of
        is_part = self.source_start is not None or self.source_end is not None
        return (self.made_of[:12] if is_part else "") or self.id


@dataclass(frozen=True)
class ClipColumn:
    """One column of the table /clips; `encode` and `decode` turn values into stored ones, and back."""

    name: str  # name of /clips/<name>, and of the attribute of `ClipRecord`
    kind: str  # what it holds: "text", "texts", "int32" or "float"
    default: Any  # value of clips of a dataset that does not have the column
    problem: Callable[[Any], str]  # returns why a value of the attribute cannot be stored; "" if it can
    encode: Callable[[Any], Any] = lambda value: value
    decode: Callable[[Any], Any] = lambda value: value
    heading: str = ""  # heading in the table that ``dancedata info --clips`` prints; empty if it is not shown there
    show: Callable[[Any], object] = str  # returns a value as that table shows it


def _line_problem(value: Any) -> str:
    # A line break would end a line of lists of names, such as those of exports.
    return "a text with a NUL or a line break" if isinstance(value, str) and "\n" in value else text_problem(value)


def _name_problem(value: Any) -> str:
    return _line_problem(value) if value else "an empty text"


def _lists_problem(value: Any) -> str:
    return problem_of("texts", value) or next(filter(None, map(_name_problem, value)), "")


def _text(name: str, heading: str = "") -> ClipColumn:
    return ClipColumn(name, "text", "", _line_problem, heading=heading)


def _count(name: str, heading: str = "", least: int = 0) -> ClipColumn:
    most = 2**31 - 1
    return ClipColumn(name, "int32", least, lambda v: whole_problem(v, least, most), int, int, heading)


def _number_problem(value: Any) -> str:
    if value is None:
        return ""
    return problem_of("float", value) or ("" if 0 <= value <= _MOST else f"not a number from 0 to {_MOST:,}")


def _rate_problem(value: Any) -> str:
    problem = _line_problem(value)
    if problem or not value or (_FRACTION.fullmatch(value) and Fraction(value) > 0):
        return problem
    return 'not a rate such as "60" or "30000/1001"'


def _number(name: str, heading: str, form: str) -> ClipColumn:
    # None is stored as NaN; an infinite value in a file is read as None too.
    return ClipColumn(
        name, "float", math.nan, _number_problem,
        lambda v: math.nan if v is None else v,
        lambda v: float(v) if math.isfinite(v) else None,
        heading, lambda v: "-" if v is None else format(v, form),
    )  # fmt: skip


def _seconds(name: str, default: Fraction | None) -> ClipColumn:
    return ClipColumn(
        name, "text", "",
        lambda v: "" if v is None or isinstance(v, (Fraction, int)) else "not a fraction",
        lambda v: "" if v == default else str(v),
        lambda v: _exact(name, v) if v else default,
    )  # fmt: skip


def _exact(name: str, text: str) -> Fraction:
    if not _FRACTION.fullmatch(text):  # 1e999999999 would take for ever
        raise StoreError("a time in seconds is not a fraction", where=f"/clips/{name}", found=shown(text),
                         allowed='a text such as "7/2"')  # fmt: skip
    return Fraction(text)


def _hash_problem(value: Any) -> str:
    good = isinstance(value, str) and len(value) in (0, 36) and set(value) <= set("0123456789abcdef")
    return "" if good else "not 36 hexadecimal digits"


#: In the order of the table.
CLIP_COLUMNS = (
    ClipColumn("id", "text", "", _name_problem, heading="clip"),
    _text("genre", "genre"),
    _text("music", "music"),
    _text("dancer"),
    _text("source"),
    ClipColumn("source_rate", "text", "", _rate_problem, heading="source fps", show=lambda v: v or "-"),
    ClipColumn("lists", "texts", (), _lists_problem),
    _number("tempo_bpm", "bpm", "g"),
    _number("height_m", "height m", ".2f"),
    _count("n_frames", "frames", least=1),
    _count("n_flags", "flags"),
    _count("trim_start", "trim"),
    _text("group"),
    _count("member", least=-1),
    _text("role"),
    _text("song"),
    _text("slice_of"),
    _count("slice_start"),
    _seconds("source_start", None),
    _seconds("source_end", None),
    _seconds("audio_start", Fraction(0)),
    _text("audio_start_by"),
    _count("licence", least=-1),
    ClipColumn("made_of", "text", "", _hash_problem),
)
#: Columns that every dataset has.
ALWAYS = ("id", "n_frames")
#: Prefix of the name of a free column.
FREE = "x/"

"""CLIP_COLUMNS: the columns of the table /clips, which writer, reader, check, diff and reports loop over.

Another attribute takes a field of `ClipRecord` and a row of `CLIP_COLUMNS`; `FORMAT` goes up with it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from dancedata.core.text import is_unicode

#: Between the entries of a list of texts, such as /clips/lists.
LIST_SEPARATOR = "\n"


@dataclass(frozen=True, kw_only=True)
class ClipRecord:
    """A clip's row of the table /clips: everything except its arrays.

    Attributes
    ----------
    id
        Name of the clip, unique in the store.
    split
        Split the clip is in. Shards hold one split each, so it is not a column.
    n_frames
        Frames at the store's fps.
    genre, music, dancer
        As the dataset names them; empty if unknown.
    tempo_bpm
        Tempo that the dataset states, beats per minute; None if unknown.
    source
        Id of the clip that this one is a copy of, else empty.
    n_flags
        Number of quality flags raised for the clip; `Store.quality` has them.
    trim_start
        First frame, at the store's fps, that belongs to the dance: according to the source, earlier ones should be
        cut. They are stored; readers skip them when asked to trim.
    height_m
        Vertical extent of the dancer's joints, median over frames, metres; None if unknown.
    source_rate
        Frames per second of the source, as text; empty if unknown.
    lists
        Names of the dataset's lists (such as split files) that the clip is in.
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


@dataclass(frozen=True)
class ColumnType:
    """Type of a column: storage, decoding and checks of its values.

    Attributes
    ----------
    dtype
        Type on disk; None: fixed-length UTF-8 text.
    problem
        Returns why a value cannot be stored; "" if it can.
    encode, decode
        Turn a value into what is stored, and back.
    """

    dtype: np.dtype[Any] | None
    problem: Callable[[Any], str]
    encode: Callable[[Any], Any]
    decode: Callable[[Any], Any]


@dataclass(frozen=True)
class ClipColumn:
    """One column of the table /clips.

    Attributes
    ----------
    name
        Name of the dataset /clips/<name>, and of the attribute of `ClipRecord`.
    heading
        Heading in the table that ``dancedata info --clips`` prints; empty if it is not shown there.
    show
        Returns a value as that table shows it.
    """

    name: str
    type: ColumnType
    heading: str = ""
    show: Callable[[Any], object] = str


def _text_problem(value: Any) -> str:
    # Fixed-length text is padded with NUL, and the entries of a list are joined by line breaks.
    if not isinstance(value, str):
        return "not a text"
    if "\0" in value or LIST_SEPARATOR in value:
        return "a text with a NUL or a line break"
    return "" if is_unicode(value) else "a text that is not valid Unicode"


def _name_problem(value: Any) -> str:
    return _text_problem(value) if value else "an empty text"


def _list_problem(value: Any) -> str:
    if isinstance(value, str):
        return "not a list of texts"
    return next(filter(None, map(_name_problem, value)), "")


def _whole_problem(value: Any, minimum: int) -> str:
    return "" if isinstance(value, Integral) and int(value) >= minimum else f"not a whole number >= {minimum}"


_INT64, _FLOAT64 = np.dtype("<i8"), np.dtype("<f8")
TEXT = ColumnType(None, _text_problem, str, str)
NAME = ColumnType(None, _name_problem, str, str)
TEXT_LIST = ColumnType(
    None, _list_problem, LIST_SEPARATOR.join, lambda v: tuple(filter(None, v.split(LIST_SEPARATOR)))
)
#: A number or None, which is stored as NaN; an infinite value in a file is read as None too.
NUMBER = ColumnType(
    _FLOAT64,
    lambda v: "" if v is None or isinstance(v, Real) else "not a number",
    lambda v: math.nan if v is None else v,
    lambda v: v if math.isfinite(v) else None,
)
COUNT = ColumnType(_INT64, lambda v: _whole_problem(v, 0), int, int)
POSITIVE = ColumnType(_INT64, lambda v: _whole_problem(v, 1), int, int)

#: In the order of a shard.
CLIP_COLUMNS = (
    ClipColumn("id", NAME, "clip"),
    ClipColumn("genre", TEXT, "genre"),
    ClipColumn("music", TEXT, "music"),
    ClipColumn("dancer", TEXT),
    ClipColumn("source", TEXT),
    ClipColumn("source_rate", TEXT, "source fps", lambda v: v or "-"),
    ClipColumn("lists", TEXT_LIST),
    ClipColumn("tempo_bpm", NUMBER, "bpm", lambda v: "-" if v is None else f"{v:g}"),
    ClipColumn("height_m", NUMBER, "height m", lambda v: "-" if v is None else f"{v:.2f}"),
    ClipColumn("n_frames", POSITIVE, "frames"),
    ClipColumn("n_flags", COUNT, "flags"),
    ClipColumn("trim_start", COUNT, "trim"),
)

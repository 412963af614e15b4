"""Values of a manifest that are more than a text: seconds, joint maps, free columns."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from dancedata.core.clip import FOUND, ColumnValue, check_name
from dancedata.core.errors import SourceError, StoreError, UsageError, did_you_mean
from dancedata.core.grid import as_fraction
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import quoted, shown
from dancedata.files.strict_json import parse_json, read_json
from dancedata.formats.bvh.producers import producers

#: Before the name of a free column.
FREE = "x/"
#: Columns of seconds, with what they may be.
SECONDS = {
    "audio_start_s": "seconds such as 1.25 or 1/3; negative where the music begins later than the motion; or auto",
    "start_s": "seconds of the motion file, from 0 on, such as 12.5 or 37/3",
    "end_s": "seconds of the motion file after start_s, such as 30 or 61/3",
}
#: Largest number of seconds: eleven days.
_MAX_S = 1_000_000
#: Largest file of a joint map, bytes; most free columns and entries of a list.
_MAX_MAP, _MAX_FREE, _MAX_ENTRIES = 1 << 16, 100, 4096
_WHOLE = re.compile(r"-?(0|[1-9][0-9]{0,17})")
_NUMBER = re.compile(r"-?(0|[1-9][0-9]{0,17})(\.[0-9]{1,30})?([eE][+-]?[0-9]{1,2})?")
_INT64 = 2**63
#: Returns the error of one cell: problem, found, allowed, fix.
Bad = Callable[..., SourceError]


def seconds(values: Mapping[str, str], bad: Bad) -> dict[str, Fraction]:
    """Return the columns of seconds that a row has, exactly as written; SourceError for one that cannot be."""
    found = {}
    for column, allowed in SECONDS.items():
        if column in values:
            text = values[column]
            if column == "audio_start_s" and text == FOUND:
                found[column] = Fraction(0)
                continue
            try:
                value = as_fraction(text if len(text) <= 40 else "too long", column)
            except UsageError as error:
                raise _bad_seconds(bad, column, text, "not a number of seconds", allowed) from error
            if abs(value) > _MAX_S:
                raise _bad_seconds(bad, column, text, "too many seconds", f"at most {_MAX_S:,}")
            found[column] = value
    if found.get("start_s", 0) < 0:
        raise _bad_seconds(bad, "start_s", values["start_s"], "before the motion begins", SECONDS["start_s"])
    if "end_s" in found and found["end_s"] <= found.get("start_s", 0):
        text = f"{values['end_s']}, and start_s {values.get('start_s', '0')}"
        raise _bad_seconds(bad, "end_s", text, "not after start_s", SECONDS["end_s"])
    if "audio_start_s" in found and "audio" not in values:
        fix = "name the music in the column audio, or leave audio_start_s empty"
        raise bad("audio_start_s is given, but the clip has no audio", values["audio_start_s"], None, fix)
    return found


def _bad_seconds(bad: Bad, column: str, found: str, why: str, allowed: str) -> SourceError:
    return bad(f"{column} is {why}", shown(found, 80), allowed, f"correct {column}, or leave it empty")


def joint_map(text: str, motion: str, file_of: Callable[[str], Path], bad: Bad) -> str:
    """Return the joint map of a BVH's row as JSON: of an object, a producer's name, or the path of a file."""
    producer = f"the name of a producer ({', '.join(producers())})"
    allowed = f'{{"left_hip": "LeftUpLeg", ...}}, the path of a .json file that has it, or {producer}'
    if Path(motion).suffix.lower() != ".bvh":
        fix = "leave joint_map empty, or name a BVH file in motion"
        raise bad("joint_map is for BVH files", shown(motion, 80), "a row whose motion is a .bvh", fix)
    if text in producers():
        return json.dumps(text)
    try:
        found = parse_json(text) if text.startswith("{") else read_json(file_of(text), _MAX_MAP)
    except (OSError, ValueError) as error:
        raise bad("joint_map cannot be read", f"{quoted(text, 60)}: {shown(error)}", allowed) from error
    names = found.get("joints", found) if isinstance(found, dict) else found
    if not isinstance(names, dict) or not names:
        raise bad("joint_map is not a mapping of joints", quoted(text, 60), allowed)
    for joint, name in names.items():
        if joint not in SMPL24.joints:
            problem = f"joint_map has a key that is not a joint of SMPL: {quoted(joint, 40)}"
            raise bad(problem, None, did_you_mean(joint, SMPL24.joints))
        if not isinstance(name, str):
            raise bad(f"joint_map: {joint} is not the name of one joint", shown(repr(name), 60), allowed)
    return json.dumps(names, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def genre_numbers(rows: Sequence[tuple[str, str, Bad]]) -> dict[str, int]:
    """Return the number of each genre of rows (genre, genre_id, error), one to one; SourceError if it is not."""
    numbers: dict[str, int] = {}
    for genre, text, bad in rows:
        if not text:
            continue
        if not _WHOLE.fullmatch(text) or not 0 <= int(text) < 2**31:
            raise bad("genre_id is not a number of a genre", shown(text, 60), "whole numbers from 0 on")
        if not genre:
            raise bad("genre_id is given, but the clip has no genre", text, None, "fill in the column genre")
        if numbers.setdefault(genre, int(text)) != int(text):
            found = f"{text} and {numbers[genre]} for {quoted(genre, 40)}"
            raise bad("a genre has two numbers in genre_id", found, "one number for each genre")
        other = next((name for name, n in numbers.items() if n == int(text) and name != genre), None)
        if other is not None:
            found = f"{text} for {quoted(genre, 40)} and {quoted(other, 40)}"
            raise bad("two genres have one number in genre_id", found, "one number for each genre")
    for genre, _, bad in rows if numbers else ():
        if genre and genre not in numbers:
            fix = "give each genre a number in one of its rows, or leave the column out"
            raise bad(
                "a genre has no number in genre_id", quoted(genre, 40), "a number for each genre or for none", fix
            )
    return numbers


def check_free_names(columns: Sequence[str], bad: Bad) -> None:
    """Raise SourceError for free columns whose names no dataset can store, or for too many of them."""
    names = [column.removeprefix(FREE) for column in columns if column.startswith(FREE)]
    for name in names:
        try:
            check_name(name, "column")
        except StoreError as error:
            fix = f"rename the column, such as {FREE}level"
            raise bad(f"{quoted(FREE + name, 60)} is {error.problem}", None, error.allowed, fix) from error
    if len(names) > _MAX_FREE:
        raise bad("too many free columns", f"{len(names)} columns {FREE}...", f"at most {_MAX_FREE}")


def typed(rows: Sequence[Mapping[str, Any]], bads: Sequence[Bad], *, written: bool) -> list[dict[str, ColumnValue]]:
    """Return the free columns of all rows as values, `written` ones from texts; SourceError unless of one type."""
    found: list[dict[str, ColumnValue]] = [{} for _ in rows]
    for name in sorted({name for row in rows for name in row}):
        holders = [k for k, row in enumerate(rows) if name in row]
        values = [rows[k][name] for k in holders]
        if written:
            values = _read(name, values, [bads[k] for k in holders])
        kind = ""
        for k, value in zip(holders, values, strict=True):
            own = _kind(value)
            if own is None:
                raise _bad_value(bads[k], name, value, "not a value of a free column")
            kind = _joined(kind, own)
            if not kind:
                others = f", in a column of {_kind(values[0])}"
                raise _bad_value(bads[k], name, value, "of another type than the rows above", others)
        for k, value in zip(holders, values, strict=True):
            found[k][name] = _as(kind, value)
    return found


def _read(name: str, texts: Sequence[str], bads: Sequence[Bad]) -> list[Any]:
    if all(text.startswith("[") for text in texts):
        values = []
        for text, bad in zip(texts, bads, strict=True):
            try:
                values.append(parse_json(text))
            except ValueError as error:
                raise _bad_value(bad, name, text, "not a list", f": {shown(error)}") from error
        return values
    if all(_WHOLE.fullmatch(text) for text in texts):
        return [int(text) for text in texts]
    if all(_NUMBER.fullmatch(text) for text in texts):
        return [float(text) for text in texts]
    if set(texts) <= {"true", "false"}:
        return [text == "true" for text in texts]
    return list(texts)


def _kind(value: Any) -> str | None:
    """Return the type of a value; "list" for an empty one; None for what cannot be stored."""
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, int):
        return "int" if -_INT64 < value < _INT64 else None
    if isinstance(value, float):
        return "float"
    if isinstance(value, str):
        return "text" if value.isprintable() and len(value) <= 4096 else None
    if not isinstance(value, list) or len(value) > _MAX_ENTRIES:
        return None
    kinds = {_kind(entry) for entry in value}
    if kinds <= {"int", "float"}:
        return "list" if not kinds else "floats" if "float" in kinds else "ints"
    return "texts" if kinds == {"text"} else None


def _joined(kind: str, other: str) -> str:
    """Return the type that values of both have; "" for none."""
    both = {kind, other} - {""}
    for wide, narrow in (("float", {"int", "float"}), ("floats", {"ints", "floats", "list"})):
        if both <= narrow and wide in both:
            return wide
    lists = both - {"list"}
    if len(both) == 1 or ("list" in both and lists <= {"ints", "floats", "texts"} and len(lists) == 1):
        return next(iter(lists or both))
    return ""


def _as(kind: str, value: Any) -> ColumnValue:
    if kind == "float":
        return float(value)
    if isinstance(value, list):
        return tuple(float(entry) for entry in value) if kind == "floats" else tuple(value)
    result: ColumnValue = value
    return result


def _bad_value(bad: Bad, name: str, value: Any, why: str, found: str = "") -> SourceError:
    return bad(
        f"{FREE}{name} is {why}",
        f"{quoted(value, 60)}{found}",
        "one type a column: text, true and false, whole or real numbers, or lists of texts or of numbers",
        f"correct {FREE}{name}",
    )

"""Segments as rows of a text file: segments.csv and segments.jsonl, read and written."""

from __future__ import annotations

import csv
import io
import json
import math
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from dancedata.core.errors import SourceError, UsageError, did_you_mean
from dancedata.core.grid import as_fraction, as_rate
from dancedata.core.segments import CLIP_END, MAX_JOINT, Layer, Segment
from dancedata.core.tables import csv_cell, csv_text
from dancedata.core.text import quoted, shown
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import parse_json

SEGMENT_FILES = ("segments.csv", "segments.jsonl")
#: Bounds of a file, of a text, and of the number of texts of a segment.
MAX_BYTES, MAX_TEXT, MAX_TEXTS = 1 << 28, 1 << 20, 4096
#: Times beyond this are mistakes: a hundred days.
MAX_SECONDS = 8_640_000
_TIMES = ("start", "end", "fps")
_LAYER = ("layer", "kind", "language", "author", "licence", "citation", "by", "sided")
_LISTS = {"texts": "text", "texts_mirrored": "text_mirrored", "tokens": "token"}
_OTHERS = ("label", "label_mirrored", "value", "unit", "other", "joint", "whole", "data", "self_sha256")
COLUMNS = ("clip", *_TIMES, *_LAYER, *_OTHERS[:2], *_LISTS.values(), *_LISTS, *_OTHERS[2:])
_CHOICES = {"kind": ("span", "instant"), "sided": ("no", "mirrored", "unknown")}
_EMPTY: tuple[object, ...] = ("", None)
#: Name, language, author and stated kind of a layer.
_Key = tuple[str, str, str, str]


@dataclass(frozen=True)
class SegmentRow:
    """A segment of a clip, and the line of a file that states it."""

    line: int
    clip: str
    segment: Segment
    made_for: str = ""  # `self_sha256` of a dataset, or ""


def read_segment_file(path: Path, language: str = "") -> list[SegmentRow]:
    """Read segments of clips; times are seconds from frame 0, or frames where a row has `fps`."""
    try:
        text = read_regular(path, MAX_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        allowed = f"UTF-8 text of at most {MAX_BYTES:,} bytes"
        raise _bad(path, None, "the segments cannot be read", shown(error), allowed) from error
    if "\n" not in text:
        text = text.replace("\r", "\n")
    rows = _Rows(path, language)
    for line, values in _csv(path, text) if path.suffix.lower() == ".csv" else _jsonl(path, text):
        names = {key: values[key] for key in ("clip", "other") if isinstance(values.get(key), str)}
        rows.add(line, values | {key: unicodedata.normalize("NFC", name) for key, name in names.items()})
    return rows.segments()


def write_segment_file(path: Path, clips: Iterable[tuple[str, Sequence[Segment]]], suffix: str = "") -> int:
    """Write segments by clip, as .csv or .jsonl, which `read_segment_file` reads; return their number."""
    rows = [_document(clip, segment) for clip, segments in clips for segment in segments]
    if (suffix or path.suffix).lower() == ".csv":
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, [name for name in COLUMNS if any(name in row for row in rows)] or ["clip"])
        writer.writeheader()
        writer.writerows({name: csv_cell(_cell(value)) for name, value in row.items()} for row in rows)
        content = text.getvalue()
    else:
        content = "".join(json.dumps(row, ensure_ascii=False, allow_nan=False) + "\n" for row in rows)
    path.write_bytes(content.encode("utf-8", "backslashreplace"))
    return len(rows)


def _cell(value: object) -> object:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, list | dict | bool) else value


def _document(clip: str, segment: Segment) -> dict[str, Any]:
    """Return a segment as JSON data, without what is empty."""
    layer, row = segment.layer, dict[str, Any](clip=clip, start=str(segment.start))
    row["end"] = "end" if segment.end == CLIP_END else str(segment.end)
    row |= {name: getattr(layer, "name" if name == "layer" else name) for name in _LAYER}
    pairs = dict(layer.mirror) | {b: a for a, b in layer.mirror}
    row |= {"label": segment.label, "label_mirrored": pairs.get(segment.label, "")}
    for many, one in _LISTS.items():
        values = getattr(segment, many)
        row |= {one: values[0]} if len(values) == 1 else {many: list(values)}
    numbers = {"value": None if math.isnan(segment.value) else segment.value, "other": segment.other}
    row |= numbers | {"unit": dict(layer.units).get(segment.label, ""), "data": dict(segment.data)}
    row |= {"joint": segment.joint} if segment.joint >= 0 else {}
    row |= {"whole": True} if segment.whole else {}
    return {name: value for name, value in row.items() if value not in ("", None, [], {})}


def _csv(path: Path, text: str) -> Iterator[tuple[int, dict[str, Any]]]:
    head = next((line for line in text.split("\n") if line.strip() and not line.startswith("#")), "")
    delimiter = max(",;\t", key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    columns: list[str] = []
    try:
        csv.field_size_limit(max(csv.field_size_limit(), MAX_TEXT * 8))
        for cells in reader:
            cells = [csv_text(cell.strip()) for cell in cells]
            if not any(cells) or (not columns and cells[0].startswith("#")):
                continue
            if not columns:
                columns = cells
                _check_names(path, reader.line_num, columns)
                continue
            if len(cells) != len(columns):
                found, allowed = f"{len(cells)} cells", f"{len(columns)} cells"
                fix = "put texts that contain the delimiter in double quotes"
                raise _bad(path, reader.line_num, "the line has the wrong number of cells", found, allowed, fix)
            yield reader.line_num, {
                name: _parsed(path, reader.line_num, name, cell)
                for name, cell in zip(columns, cells, strict=True) if cell
            }  # fmt: skip
    except csv.Error as error:
        raise _bad(path, reader.line_num, "not valid CSV", shown(error), "cells separated by commas") from error


def _parsed(path: Path, line: int, name: str, cell: str) -> Any:
    """Return the value of a cell: lists, objects and truth values are JSON."""
    if name not in (*_LISTS, "data", "whole"):
        return cell
    try:
        return parse_json(cell)
    except ValueError as error:
        allowed = {"data": '{"KEY": NUMBER}', "whole": "true or false"}.get(name, '["TEXT", "TEXT"]')
        one = _LISTS.get(name)
        fix = f"write one text into the column {one}" if one else "correct the cell"
        raise _bad(path, line, f"{name} is not JSON", quoted(cell, 60), allowed, fix) from error


def _jsonl(path: Path, text: str) -> Iterator[tuple[int, dict[str, Any]]]:
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        try:
            row = parse_json(line)
        except ValueError as error:
            raise _bad(path, number, "not valid JSON", shown(error), "one object per line") from error
        if not isinstance(row, dict):
            raise _bad(path, number, "not a JSON object", type(row).__name__, '{"clip": ..., "start": ...}')
        _check_names(path, number, list(row))
        yield number, {name: value for name, value in row.items() if value not in _EMPTY}


def _check_names(path: Path, line: int, names: Sequence[str]) -> None:
    for name in names:
        if name not in COLUMNS:
            fix = f"{did_you_mean(name[:60], COLUMNS)}; rename the column, or remove it"
            raise _bad(path, line, f"unknown column {quoted(name, 60)}", fix=fix)
    if len(set(names)) < len(names):
        raise _bad(path, line, "duplicate column", shown(", ".join(names)))
    missing = [name for name in ("clip", "start", "layer") if name not in names]
    if missing:
        allowed = "clip, start, layer, and any of the other columns"
        raise _bad(path, line, f"the column {missing[0]} is missing", shown(", ".join(names)), allowed)


class _Rows:
    """Rows that become segments once all are known: a layer gathers the units and pairs of its labels."""

    def __init__(self, path: Path, language: str) -> None:
        self._path, self._language = path, language
        self._rows: list[tuple[int, str, Segment, str]] = []
        self._layers: dict[_Key, tuple[int, Layer]] = {}
        self._units: dict[_Key, dict[str, str]] = defaultdict(dict)
        self._pairs: dict[_Key, dict[tuple[str, str], None]] = defaultdict(dict)

    def add(self, line: int, row: Mapping[str, Any]) -> None:
        """Read one row."""
        stated = {name: self._text(line, row, name) for name in ("clip", *_LAYER, "label", "label_mirrored", "unit")}
        for name in ("clip", "layer"):
            if not stated[name]:
                raise self._bad(line, f"the segment has no {name}", fix=f"fill in the column {name}")
        start, end = self._times(line, row)
        layer = self._layer(line, stated, is_instant=end is None)
        label, key = stated["label"], (layer.name, layer.language, layer.author, stated["kind"])
        if stated["unit"]:
            self._units[key][label] = stated["unit"]
        if stated["label_mirrored"]:
            self._pairs[key][min(label, stated["label_mirrored"]), max(label, stated["label_mirrored"])] = None
        lists = {many: self._list(line, row, many, one) for many, one in _LISTS.items()}
        value, joint = self._number(line, row, "value", math.nan), self._number(line, row, "joint", -1)
        whole, data = row.get("whole", False), row.get("data", {})
        is_joint = -1 <= joint <= MAX_JOINT and joint == int(joint)
        if not isinstance(whole, bool) or not isinstance(data, dict) or not is_joint:
            name = "whole" if not isinstance(whole, bool) else "data" if not isinstance(data, dict) else "joint"
            number = f"the number of a joint, at most {MAX_JOINT}"
            allowed = {"whole": "true or false", "data": "an object", "joint": number}[name]
            raise self._bad(line, f"invalid value for {name}", quoted(row[name], 60), allowed)
        if not _is_unicode(json.dumps(data, ensure_ascii=False)):
            raise self._bad(line, "data holds half of a character", quoted(row["data"], 60), "Unicode text")
        end = start if end is None else end
        if end < start:
            raise self._bad(line, "the segment ends before it begins", f"{row['start']} to {row['end']}")
        for name in ("texts_mirrored", "tokens"):
            if len(lists[name]) not in (0, len(lists["texts"])):
                found = f"{len(lists[name])} for {len(lists['texts'])}"
                raise self._bad(line, f"{name} are not as many as the texts", found, "one for each text, or none")
        segment = Segment(
            layer, start, end, label, **lists, value=value, other=self._text(line, row, "other"), joint=int(joint),
            whole=whole, data=data,
        )  # fmt: skip
        self._rows.append((line, stated["clip"], segment, self._text(line, row, "self_sha256")))

    def segments(self) -> list[SegmentRow]:
        """Return all rows, with the units and pairs of their layers."""
        complete = {
            layer: replace(layer, units=tuple(sorted(self._units[key].items())), mirror=tuple(self._pairs[key]))
            for key, (_, layer) in self._layers.items()
        }
        return [
            SegmentRow(line, clip, replace(segment, layer=complete[segment.layer]), made_for)
            for line, clip, segment, made_for in self._rows
        ]

    def _times(self, line: int, row: Mapping[str, Any]) -> tuple[Fraction, Fraction | None]:
        try:
            if any(isinstance(row.get(name), bool) for name in _TIMES):
                raise TypeError("a truth value")
            rate = as_rate(row["fps"]) if "fps" in row else Fraction(1)
            start = as_fraction(row.get("start", ""), "start") / rate
            end = row.get("end")
            last = None if end is None else CLIP_END if end == "end" else as_fraction(end, "end") / rate
        except (UsageError, TypeError) as error:
            allowed = "seconds such as 1.5 or 3/2 from frame 0 of the clip; frames, where the row has fps; end: end"
            found = ", ".join(f"{name} {quoted(row[name], 40)}" for name in _TIMES if name in row)
            raise self._bad(line, "start and end are not times", found or "no start", allowed) from error
        for time in (start, last):
            if time is not None and time != CLIP_END and abs(time) > MAX_SECONDS:
                fix = "state the rate of frames in the column fps"
                raise self._bad(line, "a time is out of range", f"{float(time):g} s", f"{MAX_SECONDS:,} s", fix)
        return start, last

    def _layer(self, line: int, stated: Mapping[str, str], *, is_instant: bool) -> Layer:
        values = {name: stated[name] for name in _LAYER if name != "layer" and stated[name]}
        for name, allowed in _CHOICES.items():
            if values.get(name, allowed[0]) not in allowed:
                raise self._bad(line, f"invalid value for {name}", quoted(values[name], 40), ", ".join(allowed))
        kind = "instant" if is_instant else "span"
        values = {"language": self._language, "kind": kind, **values}
        layer = Layer(stated["layer"], **values)  # type: ignore[arg-type]
        # Spans and instants of one name, such as quality flags, where rows state which they are.
        key = (layer.name, layer.language, layer.author, stated["kind"])
        first, earlier = self._layers.setdefault(key, (line, layer))
        if earlier != layer:
            wrong = next(name for name in _LAYER[1:] if getattr(earlier, name) != getattr(layer, name))
            found = f"{quoted(getattr(layer, wrong), 40)}, and {quoted(getattr(earlier, wrong), 40)} in line {first}"
            fix = "an instant has no end, or kind: instant" if wrong == "kind" else f"write one {wrong} for the layer"
            raise self._bad(line, f"rows of layer {quoted(layer.name, 40)} differ in {wrong}", found, fix=fix)
        return earlier

    def _list(self, line: int, row: Mapping[str, Any], many: str, one: str) -> tuple[str, ...]:
        values = row.get(many, [])
        if one in row and many in row:
            raise self._bad(line, f"both {one} and {many} are given", fix="give one of them")
        values = [row[one]] if one in row else values
        if not isinstance(values, list) or not all(isinstance(v, str) and _is_text(v) for v in values):
            raise self._bad(line, f"{many} is not a list of texts", quoted(values, 60), '["TEXT", "TEXT"]')
        longest = max(map(len, values), default=0)
        if len(values) > MAX_TEXTS or longest > MAX_TEXT:
            found = f"{len(values):,} texts, the longest of {longest:,} characters"
            raise self._bad(line, f"{many} is too long", found, f"{MAX_TEXTS:,} texts of {MAX_TEXT:,} characters")
        return tuple(values)

    def _text(self, line: int, row: Mapping[str, Any], name: str) -> str:
        value = row.get(name, "")
        if not isinstance(value, str) or len(value) > MAX_TEXT or not _is_text(value):
            raise self._bad(line, f"{name} is not a text", quoted(value, 60))
        return value

    def _number(self, line: int, row: Mapping[str, Any], name: str, missing: float) -> float:
        try:
            number = float(row.get(name, missing))
        except (TypeError, ValueError):
            number = math.inf
        if math.isinf(number) or (math.isnan(number) and name in row):
            raise self._bad(line, f"{name} is not a number", quoted(row[name], 60))
        return number

    def _bad(
        self, line: int, problem: str, found: object = None, allowed: object = None, fix: str = ""
    ) -> SourceError:
        return _bad(self._path, line, problem, found, allowed, fix or "correct the line")


def _is_text(value: str) -> bool:
    return "\0" not in value and _is_unicode(value)


def _is_unicode(value: str) -> bool:
    """Whether a text has no half of a character (a lone surrogate), which no UTF-8 file can hold."""
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def _bad(
    path: Path, line: int | None, problem: str, found: object = None, allowed: object = None, fix: str = "correct it"
) -> SourceError:
    where = str(path) if line is None else f"{path}, line {line}"
    return SourceError(f"segments: {problem}", where=where, found=found, allowed=allowed, fix=fix)

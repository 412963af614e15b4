"""The manifest of a folder: manifest.csv or manifest.jsonl, one line per clip."""

import csv
import io
import json
import math
import os
import sys
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from pathlib import Path, PureWindowsPath
from typing import Any

from dancedata.core.audio_signal import AUDIO_SUFFIXES
from dancedata.core.clip import FOUND, SPLIT_ORDER, ClipRef, ColumnValue, check_name
from dancedata.core.errors import DataError, SourceError, StoreError, did_you_mean
from dancedata.core.motion import Motion
from dancedata.core.tables import csv_text
from dancedata.core.text import counted, quoted, shown
from dancedata.datasets.files import existing
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.manifest_values import (
    FREE,
    SECONDS,
    check_free_names,
    genre_numbers,
    joint_map,
    seconds,
    typed,
)
from dancedata.files.listing import stem_of
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import parse_json
from dancedata.formats.values import MOTION_SUFFIXES

_ABOUT = ("id", "motion", "audio", "split", "genre", "genre_id", "music", "dancer", "tempo_bpm")
_DECLARED = ("fps", "up", "unit", "layout", "gender", "person", "joint_map")
#: Of a manifest that was proposed: columns that are guesses, and how the row's values were found.
_PROPOSED = ("guessed", "evidence")
COLUMNS = (*_ABOUT, *_DECLARED, *SECONDS, "licence", "citation", *_PROPOSED)
#: Enough for a hundred thousand clips.
MAX_BYTES = 1 << 24
_MAX_LINE = 1 << 16
MAX_ID = 200
MAX_TEMPO = 1000.0
ID_ALLOWED = f"at most {MAX_ID} printable characters without slashes, not starting with a dot"
_DELIMITERS = ",;\t"


@dataclass(frozen=True)
class Row:
    """A line of the manifest: its number, the cells that are not empty, declarations, exact seconds, free columns."""

    line: int
    values: Mapping[str, str]
    declared: Declared
    seconds: Mapping[str, Fraction] = field(default_factory=dict)
    columns: Mapping[str, ColumnValue] = field(default_factory=dict)

    def get(self, column: str) -> str:
        """Return the value of a column, "" if it is empty."""
        return self.values.get(column, "")

    @property
    def tempo_bpm(self) -> float | None:
        """Tempo, beats per minute."""
        return float(self.values["tempo_bpm"]) if "tempo_bpm" in self.values else None


def read_manifest(path: Path) -> list[Row]:
    """Read and check a manifest, but not whether its files exist; SourceError with the line."""
    try:
        text = read_regular(path, MAX_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        allowed, fix = f"UTF-8 text of at most {MAX_BYTES:,} bytes", "save it as UTF-8 text"
        raise _bad(path, None, "the manifest cannot be read", str(error), allowed, fix) from error
    if "\n" not in text:
        text = text.replace("\r", "\n")
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > _MAX_LINE:
            raise _bad(path, number, "a line is too long", f"{len(line):,} characters", f"at most {_MAX_LINE:,}")
    lines = _csv(path, text) if path.suffix == ".csv" else _jsonl(path, text)
    read = list(lines)
    free = [{name.removeprefix(FREE): value for name, value in v.items() if name.startswith(FREE)} for _, v in read]
    known = [(line, {c: v for c, v in values.items() if not c.startswith(FREE)}) for line, values in read]
    columns = typed(free, [partial(_bad, path, line) for line, _ in read], written=path.suffix == ".csv")
    rows = [_row(path, line, values, of_row) for (line, values), of_row in zip(known, columns, strict=True)]
    if not rows:
        raise _bad(path, None, "the manifest contains no clip", "no line", "one line per clip")
    _check_unique(path, rows)
    return rows


def genre_ids_of(path: Path, rows: Sequence[Row]) -> dict[str, int]:
    """Return the number of each genre that a manifest states; empty if it states none. SourceError for a mistake."""
    return genre_numbers([(row.get("genre"), row.get("genre_id"), partial(_bad, path, row.line)) for row in rows])


def guess_notes(rows: Sequence[Row]) -> list[str]:
    """Return the note on guesses that nobody has confirmed, see `dancedata.datasets.folder.propose`."""
    guessed = [row for row in rows if row.get("guessed")]
    if not guessed:
        return []
    columns = Counter(column for row in guessed for column in row.get("guessed").split())
    counts = ", ".join(f"{column} of {n}" for column, n in sorted(columns.items()))
    first = f"the first in line {guessed[0].line}"
    fix = "check these rows, and empty their column guessed"
    return [f"UNCONFIRMED GUESSES in {counted(len(guessed), 'row')} of the manifest ({counts}; {first}): {fix}."]


def inside(source: Path, text: str, manifest: Path, line: int, column: str) -> Path:
    """Return a path of the manifest, which need not exist; SourceError if it is outside the source folder."""
    allowed, fix = "a path below the source folder", "move the file into the source folder"
    try:
        path = existing(source, text)
        real, root = path.resolve(), source.resolve()
        path.is_file()  # raises for a name that is too long for the file system
        foreign = not path.exists() and bool(PureWindowsPath(text).drive)
        if not (Path(text).is_absolute() or foreign) and ".." not in Path(text).parts and real.is_relative_to(root):
            return path
        found = shown(text) if real.is_relative_to(root) else f"{shown(text)}, which is {shown(real)}"
    except (OSError, ValueError, RuntimeError) as error:  # too long, a zero byte, circular links
        raise _bad(
            manifest, line, f"{column} is not a usable path", f"{quoted(text)}: {shown(error)}", allowed, fix
        ) from error
    raise _bad(manifest, line, f"{column} is outside the source folder", found, allowed, fix)


def _csv(path: Path, text: str) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the lines by column; the delimiter is the most frequent candidate in the first line, not a remark."""
    head = next((line for line in text.split("\n") if line.strip() and not line.startswith(("#", '"#'))), "")
    delimiter = max(_DELIMITERS, key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    columns: list[str] = []
    try:
        for cells in reader:
            cells = [csv_text(cell.strip()) for cell in cells]
            if not any(cells) or (not columns and cells[0].startswith("#")):
                continue
            if not columns:
                columns = cells
                _check_columns(path, reader.line_num, columns)
                continue
            if len(cells) != len(columns):
                problem = "the line has the wrong number of cells"
                fix = "put cells that contain the delimiter in double quotes"
                raise _bad(path, reader.line_num, problem, f"{len(cells)} cells", f"{len(columns)} cells", fix)
            yield reader.line_num, {c: v for c, v in zip(columns, cells, strict=True) if v}
    except csv.Error as error:
        raise _bad(path, reader.line_num, "not valid CSV", str(error), "cells separated by commas") from error


def _jsonl(path: Path, text: str) -> Iterator[tuple[int, dict[str, Any]]]:
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        try:
            obj = parse_json(line, _unique_keys)
        except ValueError as error:
            raise _bad(path, number, "not valid JSON", str(error), "one object per line") from error
        if not isinstance(obj, dict):
            raise _bad(path, number, "not a JSON object", f"{type(obj).__name__}", '{"id": ..., "motion": ...}')
        _check_columns(path, number, list(obj))
        stated = {key: value for key, value in obj.items() if value not in (None, "")}
        yield number, {k: v if k.startswith(FREE) else _text(path, number, k, v) for k, v in stated.items()}


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        raise ValueError("duplicate key")
    return mapping


def _text(path: Path, line: int, key: str, value: object) -> str:
    if isinstance(value, str):
        return value.strip()
    if type(value) in (int, float):
        return repr(value)
    if key == "joint_map" and isinstance(value, dict):
        return json.dumps(value)
    raise _bad(path, line, f"{key} is neither text nor a number", f"{type(value).__name__}", "text or a number")


def _check_columns(path: Path, line: int, columns: list[str]) -> None:
    bad = partial(_bad, path, line)
    if path.suffix == ".csv" and not set(columns) & set(COLUMNS):
        problem, found = "the first line contains no known column", shown(", ".join(columns), 100)
        raise bad(problem, found, ", ".join(COLUMNS), "start with a line such as motion,audio,split")
    for column in columns:
        if column not in COLUMNS and not column.startswith(FREE):
            problem = f"unknown column {quoted(column, 60)}; {did_you_mean(column[:60], COLUMNS)}"
            raise bad(problem, fix=f"rename the column, or remove it; columns of your own are {FREE}NAME")
    check_free_names(columns, bad)
    if len(set(columns)) < len(columns):
        raise bad("duplicate column", shown(", ".join(columns)))
    if "motion" not in columns:
        found = shown(", ".join(columns)) or "nothing"
        raise bad("the column motion is missing", found, "motion, and any of the other columns")


def _row(path: Path, line: int, values: dict[str, str], columns: Mapping[str, ColumnValue]) -> Row:
    bad = partial(_bad, path, line)
    for column, value in values.items():
        if any(not c.isprintable() for c in value) or len(value) > 4096:
            raise bad(f"{column} is not printable text", quoted(value, 60), "printable characters")
    if "motion" not in values:
        raise bad("the clip has no motion", shown(", ".join(values.values()), 100), "the path of its motion file")
    tempo = values.get("tempo_bpm")
    try:
        valid = tempo is None or ("_" not in tempo and 0 < float(tempo) < MAX_TEMPO)
    except ValueError:
        valid = False
    if not valid:
        allowed = f"beats per minute, above 0, below {MAX_TEMPO:g}"
        raise bad("tempo_bpm is not a tempo", shown(tempo, 40), allowed)
    for column in {"motion", "audio"} & values.keys():
        if not os.path.exists(path.parent / values[column]):
            values[column] = values[column].replace("\\", "/")  # as Windows writes paths
    for column in {"id", "music", "genre", "dancer"} & values.keys():
        values[column] = unicodedata.normalize("NFC", values[column])
    problem = id_problem(values.get("id") or stem_of(Path(values["motion"])))
    if problem is not None:
        found = quoted(values.get("id") or values["motion"], 60)
        raise bad(f"the id {problem}", found, ID_ALLOWED, "give the clip another id")
    if "joint_map" in values:
        file_of = partial(inside, path.parent, manifest=path, line=line, column="joint_map")
        values["joint_map"] = joint_map(values["joint_map"], values["motion"], file_of, bad)
    declared = Declared(**{name: values[name] for name in _DECLARED if name in values})
    wrong = declared.problem()
    if wrong is not None:
        name, value, allowed = wrong
        raise bad(f"invalid value for {name}", shown(value, 60), allowed, f"correct {name}, or leave it empty")
    return Row(line, values, declared, seconds(values, bad), columns)


def check_row(manifest: Path, row: Row, split: str) -> None:
    """Check the constraints of a built dataset and of the audio reader."""
    where = f"{manifest}, line {row.line}"
    usual = split.casefold()
    if usual in SPLIT_ORDER and split not in SPLIT_ORDER:
        problem = f"folder: the split {split!r} differs from {usual!r} only by case"
        raise SourceError(problem, where=where, fix=f"write it as {usual}, the name that readers and statistics use")
    try:
        check_name(split or "train", "split")
    except StoreError as error:
        raise SourceError(
            f"folder: {error.problem}", where=where, found=error.found, allowed=error.allowed
        ) from error
    for column, suffixes in (("motion", MOTION_SUFFIXES), ("audio", AUDIO_SUFFIXES)):
        suffix = Path(row.get(column)).suffix.lower()
        if row.get(column) and suffix not in suffixes:
            problem = f"folder: {column} has an unsupported file format"
            raise SourceError(problem, where=where, found=row.get(column)[:100], allowed=", ".join(suffixes))


def _check_unique(path: Path, rows: list[Row]) -> None:
    lines: dict[str, int] = {}
    for row in rows:
        name = clip_id(row)
        if name in lines:
            problem, found = f"two clips have the id {name!r}", f"lines {lines[name]} and {row.line}"
            raise _bad(path, row.line, problem, found, "unique ids", "add a column id with unique ids")
        lines[name] = row.line


def id_problem(name: str) -> str | None:
    """Return why an id, which becomes part of file names, is invalid; None if it is valid."""
    if not name or name.startswith("."):
        return "starts with a dot" if name else "is empty"
    if "/" in name or "\\" in name:
        return "contains a slash"
    if not name.isprintable():
        locale = f" (the locale's encoding is {code})" if (code := sys.getfilesystemencoding()) != "utf-8" else ""
        return f"contains characters that cannot be printed{locale}"
    return f"is longer than {MAX_ID} characters" if len(name) > MAX_ID else None


def clip_id(row: Row) -> str:
    """Return the clip's id: the column id, else the name of its motion file."""
    return row.get("id") or stem_of(Path(row.get("motion")))


def _bad(
    path: Path,
    line: int | None,
    problem: str,
    found: object = None,
    allowed: object = None,
    fix: str = "correct the manifest",
) -> SourceError:
    where = str(path) if line is None else f"{path}, line {line}"
    return SourceError(f"folder: {problem}", where=where, found=found, allowed=allowed, fix=fix)


def part_of(motion: Motion, ref: ClipRef) -> Motion:
    """Return the frames of a file that are the clip; DataError for none, or more than the file has."""
    if ref.source_start is None and ref.source_end is None:
        return motion
    rate, n = motion.grid.rate, motion.n_frames
    first = int((ref.source_start or 0) * rate)
    stop = n if ref.source_end is None else int(ref.source_end * rate)
    if not first < stop or first >= n or stop > n:
        beyond = stop > n > first
        raise DataError(
            "the part of the manifest goes beyond the motion file" if beyond else "no frame of the part is left",
            reason="bad_declaration" if beyond else "too_short",
            where=str(ref.motion_path),
            found=f"frames {first:,} to {stop:,} by start_s and end_s, of {n:,} at {motion.grid} per second",
            allowed=f"0 to {float(motion.grid.seconds(n)):g} s",
            fix=f"correct start_s or end_s of clip {ref.id} in the manifest; an empty end_s is the end of the file",
        )
    return motion.part(first, stop)


def on_frames(ref: ClipRef, rate: Fraction) -> ClipRef:
    """Return a clip whose part begins and ends at whole frames of its file, the nearest ones, and its music there."""
    first, stop = (
        None if second is None else Fraction(math.floor(second * rate + Fraction(1, 2))) / rate
        for second in (ref.source_start, ref.source_end)
    )
    return replace(ref, source_start=first or None, source_end=stop, audio_start=ref.audio_start + (first or 0))


def offset_notes(clips: Sequence[ClipRef]) -> list[str]:
    """Return the note on offsets of music that a manifest does not state."""
    left = sum(clip.audio_start_by == FOUND for clip in clips)
    return [f"Music: audio_start_s leaves the offset of {counted(left, 'clip')} to the build (auto)."] if left else []

"""Motorica++ (STREAM, 2026): genre, move and descriptions of recordings, in two published forms.

.. code-block:: text

    LABELS/
        label_segment/NAME_<i>.txt                  one segment: frames of the recording, `end` inclusive
        motorica_seg/NAME_<i>_label.txt             the same
        [motorica/]sliced_labels/NAME_chunk<k>_label.json     chunk k: 5 s from second k of the recording; half-open
        [motorica/]sliced_labels/NAME_chunk<k>_M_label.json   the words of its mirrored chunk
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from dancedata.core.clip import Reject
from dancedata.core.errors import DataError, SourceError
from dancedata.core.segments import Layer, Segment
from dancedata.core.text import counted, listed, quoted, shown
from dancedata.datasets.files import describe, relative
from dancedata.datasets.published import Labels
from dancedata.files.listing import list_folder
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import parse_json

LAYER = Layer(
    "description",
    language="en",
    author="Motorica++",
    licence="CC BY-NC 4.0",
    citation="Motorica++, the annotations of STREAM, ECCV 2026",
)
#: Folders of labels.
FOLDERS = ("label_segment", "motorica_seg", "sliced_labels", "motorica/sliced_labels")
_TEXT = re.compile(r"(?P<name>.+?)_(?P<number>\d+)(?:_label)?")
_CHUNK = re.compile(r"(?P<name>.+)_chunk(?P<number>\d+)(?P<mirrored>_M)?_label")
_MAX_BYTES = 1 << 22
#: Seconds between the first frames of two chunks of the published files.
_STRIDE_S = 1


def read_labels(folder: Path) -> Labels:
    """Read the segments of recordings, from frame 0, in text files, or else in chunks. SourceError without labels."""
    texts: dict[str, dict[int, Path]] = defaultdict(dict)
    chunks: dict[str, dict[tuple[int, bool], Path]] = defaultdict(dict)
    rejects = []
    for part in [path for name in FOLDERS if (path := folder / name).is_dir()] or [folder]:
        for path in list_folder(part) if part.is_dir() else []:
            chunk, text = _CHUNK.fullmatch(path.stem), _TEXT.fullmatch(path.stem)
            if path.suffix == ".json" and chunk:
                chunks[chunk["name"]][int(chunk["number"]), bool(chunk["mirrored"])] = path
            elif path.suffix == ".txt" and text:
                texts[text["name"]].setdefault(int(text["number"]), path)
            else:
                detail = "neither NAME_<i>.txt nor NAME_chunk<k>_label.json"
                rejects.append(Reject("extra_file", file=relative(path, folder), detail=detail))
    if not texts and not chunks:
        raise SourceError("motorica: there are no labels", where=str(folder),
                          found=describe(folder) if folder.is_dir() else "no such folder",
                          allowed="label_segment/NAME_<i>.txt, or sliced_labels/NAME_chunk<k>_label.json",
                          fix="correct labels")  # fmt: skip
    segments: dict[str, tuple[Segment, ...]] = {}
    for name in sorted({*texts, *chunks}):
        try:
            # As a number: 10 comes after 3.
            parts = [read_text(path) for _, path in sorted(texts[name].items())] if name in texts else None
            segments[name] = tuple(joined(chunks[name]) if parts is None else parts)
        except DataError as error:
            file = relative(Path(str(error.where)), folder)
            rejects.append(Reject(error.reason, clip=name, file=file, detail=str(error)))
    unused = sorted(chunks.keys() & texts.keys())
    note = f"Labels: Motorica++ of {counted(len(segments), 'recording')}; frame 0 is that of the recording."
    if unused:
        note += f" Chunks are not read where there are whole segments: {listed(unused, 3)}."
    return Labels(segments, tuple(rejects), (note,))


def read_text(path: Path) -> Segment:
    """Read a text file: one segment, its `end` the last frame; DataError ``bad_segment``."""
    stated: dict[str, str] = {}
    for line in _read(path).splitlines():
        key, colon, value = line.partition(":")
        if colon:
            stated.setdefault(key.strip(), value.strip())
    try:
        rate, start, end = (Fraction(stated[name]) for name in ("fps", "start", "end"))
        if rate <= 0 or end < start:
            raise ValueError(f"fps {rate}, start {start}, end {end}")
    except (KeyError, ValueError, ZeroDivisionError) as error:
        raise _bad(path, shown(error), "lines genre, label, start, end, fps, description") from error
    descriptions = [stated.get("description", "")]
    return _segment(start / rate, (end + 1) / rate, stated.get("genre", ""), stated.get("label", ""), descriptions)


def joined(chunks: Mapping[tuple[int, bool], Path]) -> list[Segment]:
    """Return the segments of a recording from those of its chunks, which overlap; DataError ``bad_segment``."""
    parts: dict[tuple[Any, ...], list[tuple[Fraction, Fraction, Segment]]] = defaultdict(list)
    frames: dict[Fraction, tuple[Any, Path]] = {}
    for (number, is_mirrored), path in sorted(chunks.items()):
        if is_mirrored:
            continue
        rate, segments, length = _chunk(path)
        words = _mirrored_words(segments, chunks.get((number, True)))
        labels: dict[int, Any] = dict.fromkeys(range(length), ("", ()))
        for (span, segment), mirrored in zip(segments, words, strict=True):
            key = (segment.label, segment.texts, mirrored, str(segment.data))
            shift = Fraction(number * _STRIDE_S)
            parts[key].append((segment.start + shift, segment.end + shift, replace(segment, texts_mirrored=mirrored)))
            labels |= dict.fromkeys(span, (segment.label, segment.texts))
        for frame, label in labels.items():
            at = number * _STRIDE_S + frame / rate
            known, first = frames.setdefault(at, (label, path))
            if known != label:
                found = f"{quoted(label[0], 40)} at {float(at):g} s, and {quoted(known[0], 40)} in {first.name}"
                raise _bad(
                    path, found, "chunks k that begin at second k of the recording and agree where they overlap"
                )
    result = [segment for group in parts.values() for segment in _union(group)]
    return sorted(result, key=lambda segment: (segment.start, segment.end, segment.label))


def _union(parts: Iterable[tuple[Fraction, Fraction, Segment]]) -> list[Segment]:
    union: list[Segment] = []
    for start, end, segment in sorted(parts, key=lambda part: part[:2]):
        if union and start <= union[-1].end:
            union[-1] = replace(union[-1], end=max(end, union[-1].end))
        else:
            union.append(replace(segment, start=start, end=end))
    return union


def _mirrored_words(segments: Sequence[tuple[range, Segment]], path: Path | None) -> list[tuple[str, ...]]:
    """Return the words of the mirrored chunk for each segment, where it has the same ones."""
    mirrored = [] if path is None else _chunk(path)[1]
    same = [(span, len(s.texts)) for span, s in segments] == [(span, len(s.texts)) for span, s in mirrored]
    return [s.texts for _, s in mirrored] if same else [()] * len(segments)


def _chunk(path: Path) -> tuple[Fraction, list[tuple[range, Segment]], int]:
    """Return the rate of a chunk, its segments with their frames, and its number of frames."""
    allowed = '{"fps": 30, "length": 150, "segments": [{"start": 0, "end": 10, "genre": ..., "label": ..., ...}]}'
    try:
        document = parse_json(_read(path))
        rate, length = Fraction(str(document["fps"])), int(document["length"])
        segments = []
        for entry in document["segments"]:
            start, end = int(entry["start"]), int(entry["end"])
            if end < start or rate <= 0:
                raise ValueError(f"fps {rate}, start {start}, end {end}")
            texts = entry.get("descriptions", entry.get("description", ""))
            texts = [texts] if isinstance(texts, str) else texts
            if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
                raise TypeError(f"descriptions of type {type(texts).__name__}")
            named = [str(entry.get(name, "")) for name in ("genre", "label")]
            segments.append((range(start, end), _segment(start / rate, end / rate, named[0], named[1], texts)))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _bad(path, shown(error), allowed) from error
    return rate, segments, length


def _segment(start: Fraction, end: Fraction, genre: str, label: str, texts: Sequence[str]) -> Segment:
    texts = tuple(text for text in texts if text)
    return Segment(LAYER, start, end, label, texts, data={"genre": genre} if genre else {})


def _read(path: Path) -> str:
    try:
        return read_regular(path, _MAX_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise _bad(path, shown(error), "UTF-8 text") from error


def _bad(path: Path, found: str, allowed: str) -> DataError:
    problem = "a label of Motorica++ cannot be used"
    return DataError(problem, reason="bad_segment", where=path, found=found, allowed=allowed, fix="correct the file")


def write_example(folder: Path, name: str) -> None:
    """Write synthetic labels of a recording of 6 s, in both forms: a gap, an overlap, several descriptions."""
    moves = [
        (0, 45, "step touch", ["steps to the left, then to the right"]),
        (45, 100, "spin", ["spins clockwise", "turns around once, clockwise"]),
        (90, 130, "wave", ["waves with the left arm"]),
        (150, 180, "freeze", ["holds a pose"]),
    ]
    from dancedata.datasets._examples import write_json, write_lines

    for k, (start, end, label, texts) in enumerate(moves):
        lines = {"genre": "jazz", "label": label, "start": start, "end": end - 1, "fps": 30, "description": texts[0]}
        path = folder / "label_segment" / f"{name}_{k}.txt"
        write_lines(path, [f"{key}: {value}" for key, value in lines.items()])
    for chunk in (0, 1):
        first = chunk * 30
        segments = [
            {"start": max(start - first, 0), "end": min(end - first, 150), "genre": "jazz", "label": label,
             **({"description": texts[0]} if len(texts) == 1 else {"descriptions": texts})}
            for start, end, label, texts in moves
            if start < first + 150 and end > first
        ]  # fmt: skip
        document = {"fps": 30, "length": 150, "segments": segments}
        write_json(folder / "sliced_labels" / f"{name}_chunk{chunk}_label.json", document)

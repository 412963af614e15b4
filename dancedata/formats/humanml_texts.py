"""Captions of one clip in HumanML3D's texts/NAME.txt: ``caption#tokens#start#end`` on each line."""

import math
import re
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

from dancedata.core.errors import DataError
from dancedata.core.segments import CLIP_END, Layer, Segment
from dancedata.core.text import quoted, shown
from dancedata.files.regular_file import read_regular

MAX_BYTES = 1 << 24


def read_texts(path: Path, layer: Layer) -> list[Segment]:
    """Read the captions of a clip; those of one span are one segment, 0 to 0 is the clip. DataError with line."""
    try:
        text = read_regular(path, MAX_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError("captions cannot be read", reason="bad_segment", where=path, found=shown(error)) from error
    spans: dict[tuple[Fraction, Fraction], list[tuple[str, str]]] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        caption, *rest = line.strip().rsplit("#", 3)
        times = [_seconds(part) for part in rest[1:]]
        start, end = (times[0], times[1]) if len(times) == 2 else (None, None)
        if not caption.strip() or start is None or end is None or end < start:
            raise DataError("a line is not a caption", reason="bad_segment", where=f"{path}, line {number}",
                            found=quoted(line, 80),
                            allowed="caption#word/POS word/POS#start#end, seconds; 0.0#0.0 for the whole clip",
                            fix="correct the line")  # fmt: skip
        span = (Fraction(0), CLIP_END) if start == end == 0 else (start, end)
        spans.setdefault(span, []).append((caption.strip(), rest[0].strip()))
    segments = []
    for (start, end), captions in sorted(spans.items()):
        tokens = tuple(token for _, token in captions)
        texts = tuple(caption for caption, _ in captions)
        segments.append(Segment(layer, start, end, texts=texts, tokens=tokens if any(tokens) else ()))
    return segments


def _seconds(text: str) -> Fraction | None:
    """Return a time in seconds, as it is written; None if it is none."""
    try:
        if math.isnan(float(text)):
            return Fraction(0)
        time = Fraction(text.strip())
    except (ValueError, OverflowError):
        return None
    return time if 0 <= time <= 10**6 else None


class Caption(NamedTuple):
    """A line: a text, its tokens, and seconds of the span; (0, 0) for the whole clip."""

    text: str
    tokens: str
    start: Fraction
    end: Fraction


def plain_tokens(text: str) -> str:
    """Return the words of a text as tokens of an unknown part of speech, word/OTHER."""
    return " ".join(f"{word}/OTHER" for word in re.findall(r"\w+(?:['-]\w+)*", text.lower()))


def texts_file(lines: Iterable[Caption]) -> str:
    """Return the content of a file; a ``#`` or line break in a caption, where loaders end a part, becomes a space."""
    return "".join(
        f"{' '.join(caption.replace('#', ' ').split())}#{tokens}#{float(start)!r}#{float(end)!r}\n"
        for caption, tokens, start, end in lines
    )

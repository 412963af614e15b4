"""Segments: words, events and marks in the time of a clip, in layers of one author and language."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from fractions import Fraction
from typing import Any, Literal

from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.text import quoted

#: Ticks of exact times in a second: whole for frames at 24, 25, 30, 50, 60, 100 and 120 per second and their NTSC
#: forms, and for samples at 44.1 and 48 kHz.
TICKS_PER_SECOND = 705_600_000
#: Number of a joint, of any body.
MAX_JOINT = 999
#: The end of a clip, where a source names the whole clip and not its length; a build puts the length in its place.
CLIP_END = Fraction(10**9)


@dataclass(frozen=True)
class Layer:
    """Segments of one kind, by one author in one language.

    Attributes
    ----------
    name
        Such as "words", "moves", "sections", "facts", "quality". Annotators and translations share a name.
    kind
        "span": from start to end. "instant": a moment.
    language
        BCP 47 tag; "" without words.
    by
        "file", or the producer with its version and parameters.
    units
        Unit of `Segment.value`: (label, unit).
    mirror
        Labels that are exchanged in a mirrored clip: (label, label).
    sided
        Whether words name a side: "no"; "mirrored": `Segment.texts_mirrored` has the words of a mirrored clip;
        "unknown": a build finds out, with a lexicon of the language; where it cannot, mirrored clips go without this
        layer.
    """

    name: str
    kind: Literal["span", "instant"] = "span"
    language: str = ""
    author: str = ""
    licence: str = ""
    citation: str = ""
    by: str = "file"
    units: tuple[tuple[str, str], ...] = ()
    mirror: tuple[tuple[str, str], ...] = ()
    sided: Literal["no", "mirrored", "unknown"] = "unknown"


@dataclass(frozen=True)
class Segment:
    """A span or an instant of a clip.

    Attributes
    ----------
    start, end
        Seconds from frame 0 of the clip, exact; may lie outside the clip. An instant has equal ones.
    label
        Short word: a move, a kind of event.
    texts
        Alternative descriptions; `texts_mirrored` what they are in a mirrored clip; `tokens` HumanML3D's "word/POS"
        of each, both empty or one a text.
    value
        The number of an event; nan if there is none. `Layer.units` has its unit.
    other
        Id of the partner's clip, of a contact.
    joint
        Number of a joint; -1 without.
    whole
        Whether it belongs to all dancers of the group.
    data
        Further numbers of an event, JSON.
    """

    layer: Layer
    start: Fraction
    end: Fraction
    label: str = ""
    texts: tuple[str, ...] = ()
    texts_mirrored: tuple[str, ...] = ()
    tokens: tuple[str, ...] = ()
    value: float = math.nan
    other: str = ""
    joint: int = -1
    whole: bool = False
    data: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.end < self.start:
            found = f"{float(self.start):g} s to {float(self.end):g} s, {quoted(self.label)}"
            raise DataError("a segment ends before it begins", reason="bad_segment", found=found)
        for name in ("texts_mirrored", "tokens"):
            n = len(getattr(self, name))
            if n not in (0, len(self.texts)):
                raise DataError(f"{name} of a segment are not as many as its texts", reason="bad_segment",
                                found=f"{n} for {len(self.texts)}")  # fmt: skip

    def __eq__(self, other: object) -> bool:
        """Compare attributes; without a value (nan) two are equal, which dataclasses of Python 3.13 deny."""
        if not isinstance(other, Segment):
            return NotImplemented
        mine, others = ([getattr(s, f.name) for f in fields(s) if f.name != "value"] for s in (self, other))
        without = math.isnan(self.value) and math.isnan(other.value)
        return mine == others and (without or self.value == other.value)

    def frames(self, grid: FrameGrid, n_frames: int) -> tuple[int, int]:
        """Return the frames [begin, end) of a clip that the segment covers; begin == end where it covers none.

        A frame is an instant: a span covers the frames k with start <= k / fps < end. An instant is the nearest
        frame, halves up, one frame long.
        """
        if self.layer.kind == "instant":
            place = self.start * grid.rate
            begin = min(math.floor(place + Fraction(1, 2)), n_frames - 1)
            return (begin, begin + 1) if begin >= 0 and place < n_frames else (0, 0)
        begin, end = (min(max(math.ceil(t * grid.rate), 0), n_frames) for t in (self.start, self.end))
        return (begin, end) if begin < end else (0, 0)

    @property
    def can_be_mirrored(self) -> bool:
        """Whether it is known what it says of a mirrored dancer."""
        return self.layer.sided != "unknown"

    def within(self, seconds: Fraction) -> Segment:
        """Return the segment with the length of its clip in place of `CLIP_END`."""
        return replace(self, end=max(seconds, self.start)) if self.end == CLIP_END else self


def ticks(seconds: Fraction) -> int:
    """Return a time in ticks of 1/705,600,000 s, the nearest, halves up."""
    return math.floor(seconds * TICKS_PER_SECOND + Fraction(1, 2))


def layer_json(layer: Layer, rows: int, empty: int) -> dict[str, Any]:
    """Return the entry of a layer in dataset.json: `rows` segments, and `empty` ones that cover no frame."""
    mirror = [list(pair) for pair in layer.mirror]
    return {**asdict(layer), "units": dict(layer.units), "mirror": mirror, "rows": rows, "empty": empty}


def layer_of(entry: Mapping[str, Any]) -> Layer:
    """Read what `layer_json` returned; KeyError or ValueError for anything else."""
    kind, sided = entry["kind"], entry["sided"]
    if kind not in ("span", "instant") or sided not in ("no", "mirrored", "unknown"):
        raise ValueError(f"a layer of kind {kind!r}, sided {sided!r}")
    texts = {name: str(entry[name]) for name in ("name", "language", "author", "licence", "citation", "by")}
    units = tuple((str(label), str(unit)) for label, unit in entry["units"].items())
    mirror = tuple((str(a), str(b)) for a, b in entry["mirror"])
    return Layer(kind=kind, sided=sided, units=units, mirror=mirror, **texts)


@dataclass(frozen=True)
class LayerNumbers:
    """Numbers of a layer, over clips that are not copies."""

    name: str
    kind: str
    language: str
    author: str
    licence: str
    sided: str
    segments: int  # their number
    clips: int  # with a segment
    median_s: float | None  # length of a segment; None without any
    coverage: float  # share of all frames that a segment covers
    texts: int  # their number
    words: int  # in all texts
    labels: Mapping[str, int]  # the most frequent ones

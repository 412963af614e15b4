"""Segments that a file lays over a dataset: marks and corrections that leave its files as they are."""

import logging
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from dancedata.core.errors import SourceError
from dancedata.core.segments import Layer, Segment
from dancedata.core.sided_words import with_mirrored_words
from dancedata.core.text import listed
from dancedata.files.segment_files import read_segment_file

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SegmentOverlay:
    """Segments by clip, and notes on their files."""

    segments: Mapping[str, tuple[Segment, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @classmethod
    def read(
        cls, files: Sequence[Path], self_sha256: str, length_of: Callable[[str], Fraction | None]
    ) -> "SegmentOverlay":
        """Read files of segments; `length_of` returns the seconds of a clip. SourceError for a mistake in a file."""
        by_clip: dict[str, list[Segment]] = defaultdict(list)
        notes = []
        for path in files:
            rows = read_segment_file(path)
            for row in rows:
                length = length_of(row.clip)
                unknown = row.clip if length is None else row.segment.other
                if length is None or (unknown and length_of(unknown) is None):
                    raise SourceError("segments: the dataset has no such clip",
                                      where=f"{path}, line {row.line}", found=unknown,
                                      fix="correct the line, or remove it")  # fmt: skip
                by_clip[row.clip].append(row.segment.within(length))
            others = sorted({row.made_for[:12] for row in rows if row.made_for not in ("", self_sha256)})
            if others:
                note = (
                    f"{path.name} was made for another dataset: self_sha256 {listed(others)}, not {self_sha256[:12]}"
                )
                _log.warning("%s", note)
                notes.append(note)
        segments = zip(by_clip, with_mirrored_words(list(by_clip.values())), strict=True)
        return cls(dict(segments), tuple(notes))

    @property
    def layers(self) -> tuple[Layer, ...]:
        """Layers of its segments."""
        return tuple(dict.fromkeys(s.layer for segments in self.segments.values() for s in segments))

    def over(self, clip: str, stored: Sequence[Segment]) -> list[Segment]:
        """Return the segments of a clip: those of the file replace stored ones of the same layer, start and end."""
        laid = self.segments.get(clip, ())
        if not laid:
            return list(stored)
        places = {_place(segment) for segment in laid}
        kept = [segment for segment in stored if _place(segment) not in places]
        return sorted([*kept, *laid], key=lambda segment: (segment.start, segment.end))


def _place(segment: Segment) -> tuple[object, ...]:
    layer = segment.layer
    return layer.name, layer.language, layer.author, segment.start, segment.end

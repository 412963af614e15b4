"""Words and events of clips that lie beside motion: segments.csv, segments.jsonl and HumanML3D's texts/."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError, SourceError, did_you_mean
from dancedata.core.segments import Layer, Segment
from dancedata.core.text import counted, listed, quoted
from dancedata.datasets.files import files_by_stem, relative
from dancedata.files.segment_files import SEGMENT_FILES, SegmentRow, read_segment_file
from dancedata.formats.humanml_texts import read_texts

_TEXTS = "texts"
#: Name of the layer of captions.
_DESCRIPTION = "description"


def words_of(source: Path) -> list[Path]:
    """Return the files of segments and the folder of captions in a source."""
    return [path for name in (*SEGMENT_FILES, _TEXTS) if (path := source / name).exists()]


def stated_words(
    source: Path, clips: Sequence[ClipRef], language: str
) -> tuple[list[ClipRef], list[Reject], list[str]]:
    """Return clips with the segments that a source states, what is not used, and notes; SourceError for a mistake."""
    ids = {clip.id for clip in clips}
    segments: dict[str, list[Segment]] = defaultdict(list)
    rejects: list[Reject] = []
    notes = []
    files = [path for path in words_of(source) if path.name in SEGMENT_FILES]
    if len(files) > 1:
        found = " and ".join(SEGMENT_FILES)
        raise SourceError("there are two files of segments", where=str(source), found=found, fix="remove one of them")
    for path in files:
        rows = read_segment_file(path, language)
        _require_partners(path, rows, ids)
        for row in rows:
            segments[row.clip].append(row.segment)
        unused = [row for row in rows if row.clip not in ids]
        if unused:
            of = listed(sorted({row.clip for row in unused}))
            detail = f"{counted(len(unused), 'segment')} of clips that are not there: {of}"
            rejects.append(Reject("unused_segments", file=relative(path, source), detail=detail))
        notes.append(f"Segments: {path.name}, {counted(len(rows) - len(unused), 'segment')}.")
    if (source / _TEXTS).is_dir():
        layer = Layer(_DESCRIPTION, language=language)
        captions = files_by_stem(source / _TEXTS, source, ".txt", lambda stem: "")
        rejects += captions.rejects
        for name, path in sorted(captions.files.items()):
            if name not in ids:
                detail = f"no clip named {quoted(name)}; {did_you_mean(name, sorted(ids))}"
                rejects.append(Reject("unused_segments", file=relative(path, source), detail=detail))
                continue
            try:
                segments[name] += read_texts(path, layer)
            except DataError as error:
                rejects.append(Reject(error.reason, clip=name, file=relative(path, source), detail=str(error)))
        notes.append(f"Captions: {_TEXTS}/, of {counted(len(ids & captions.files.keys()), 'clip')}.")
    stated = [replace(clip, segments=(*clip.segments, *segments[clip.id])) for clip in clips]
    return stated, rejects, notes


def _require_partners(path: Path, rows: Sequence[SegmentRow], ids: set[str]) -> None:
    for row in rows:
        if row.clip in ids and row.segment.other and row.segment.other not in ids:
            raise SourceError("segments: the partner of a segment is not a clip", where=f"{path}, line {row.line}",
                              found=quoted(row.segment.other),
                              fix=did_you_mean(row.segment.other, sorted(ids)))  # fmt: skip

"""Motorica++: the labels of chunks that STREAM trains on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from dancedata.core.grid import FrameGrid
from dancedata.core.segments import Segment
from dancedata.core.sided_words import mirrored_segment
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing

if TYPE_CHECKING:
    from dancedata.files.atomic_folder import AtomicFolder

#: Rate of labels, frames of a chunk, and frames between two chunks.
FPS, LENGTH, STRIDE = 30, 150, 30
#: STREAM's matrix of labels cuts longer descriptions.
_MAX_TEXT = 1000


@EXPORTS.register("motorica-pp")
@dataclass(frozen=True)
class MotoricaPP(Export):
    """Motorica++'s sliced_labels: genre, label and descriptions of chunks of 5 s each second (STREAM, 2026).

    Attributes
    ----------
    layer
        Layer of the segments that are written.
    mirrored
        Whether chunks ``_M`` with the words of a mirrored dancer are written too.
    """

    version: ClassVar[int] = 1
    recipe: ClassVar[Mapping[str, Any]] = {"dataset": {"motorica": {}}, "motion": {"joints": {"body": "motorica21"}}}
    reference: ClassVar[str] = "SeongJong-Yoo/STREAM, commit a0a10fd, src/preprocessing"
    listed_folders: ClassVar[tuple[str, ...]] = ("sliced_labels",)

    layer: str = "description"
    mirrored: bool = True

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        names = sorted({layer.name for layer in job.store.layers})
        if self.layer not in names:
            problem = f"the dataset has no layer {self.layer} (it has {', '.join(names) or 'none'})"
            return [Missing(problem, "segments.csv in the source, or dataset: {motorica: {labels: DIR}}")]
        unknown = [layer for layer in job.store.layers if layer.name == self.layer and layer.sided == "unknown"]
        if unknown and self.mirrored:
            return [Missing(f"layer {self.layer} has no mirrored words", "--set mirrored=false")]
        return []

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        short, cut = [], 0
        for clip in job.each("clips", [clip for clip in job.clips() if not clip.source]):
            length = int(job.store.grid.seconds(clip.n_frames) * FPS)
            segments = job.store.segments(clip.id, self.layer)
            cut += sum(len(text) > _MAX_TEXT for segment in segments for text in segment.texts)
            for chunk, start in enumerate(range(0, length - LENGTH + 1, STRIDE)):
                file = f"sliced_labels/{clip.id}_chunk{chunk}"
                folder.write_json(f"{file}_label.json", chunk_labels(segments, start, clip.genre))
                if self.mirrored:
                    words = [mirrored_segment(segment) for segment in segments]
                    folder.write_json(f"{file}_M_label.json", chunk_labels(words, start, clip.genre))
            short += [clip.id] if length < LENGTH else []
        if short:
            folder.note(f"{counted(len(short), 'clip')} shorter than a chunk: {listed(short)}")
        if cut:
            folder.note(f"{counted(cut, 'text')} of more than {_MAX_TEXT:,} characters, which STREAM's reader cuts")

    @override
    def guide(self, job: ExportJob) -> str:
        layers = [layer for layer in job.store.layers if layer.name == self.layer]
        licences = listed(sorted({layer.licence for layer in layers} - {""}))
        return (
            "Put `sliced_labels` beside STREAM's `sliced_motion_smpl`, `sliced_audio_features` and `sliced_beats`, "
            "which are not written here.\n\n"
            f"- Chunk k is {LENGTH // FPS} s from second k of the clip, {FPS} frames per second, spans half-open.\n"
            "- Where segments overlap the later one wins, and a gap is a segment of empty texts, as STREAM's code "
            "makes of its own labels.\n"
            "- Chunks `_M` have the words of a mirrored dancer, and the music of the chunk without `_M`.\n"
            f"- Licence of the words: {licences or 'not stated'}.\n"
        )


def chunk_labels(segments: Sequence[Segment], start: int, genre: str) -> dict[str, Any]:
    """Return the labels of the chunk from a frame: spans without gap or overlap, the later segment wins."""
    frames: list[Segment | None] = [None] * LENGTH
    for segment in sorted(segments, key=lambda segment: (segment.start, segment.end)):
        first, last = (max(frame - start, 0) for frame in segment.frames(FrameGrid.of(FPS), start + LENGTH))
        frames[first:last] = [segment] * (last - first)
    begins = [k for k in range(LENGTH) if k == 0 or frames[k] is not frames[k - 1]]
    spans = [
        _span(frames[first], first, last, genre) for first, last in zip(begins, [*begins[1:], LENGTH], strict=True)
    ]
    return {"fps": FPS, "length": LENGTH, "segments": spans}


def _span(segment: Segment | None, first: int, last: int, genre: str) -> dict[str, Any]:
    if segment is None:
        return {"start": first, "end": last, "genre": "", "label": "", "description": ""}
    named = {"genre": str(segment.data.get("genre", genre)), "label": segment.label}
    texts = list(segment.texts)
    words = {"descriptions": texts} if len(texts) > 1 else {"description": texts[0] if texts else ""}
    return {"start": first, "end": last, **named, **words}

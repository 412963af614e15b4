"""dancedata info --segments: segments of a dataset, listed, written as files and replaced."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from dancedata.core.errors import RecipeError, UsageError
from dancedata.core.segments import Layer, Segment
from dancedata.core.sided_words import ENGLISH, Lexicon, with_mirrored_words
from dancedata.core.tables import table
from dancedata.core.text import counted, listed
from dancedata.files.addresses import local_folder
from dancedata.files.atomic import atomic_file
from dancedata.files.segment_files import write_segment_file
from dancedata.kernel import Clip, Store, open_store, rewrite_segments, stored_recipe

_SUFFIXES = (".csv", ".jsonl")
#: The segment of a copy, of a segment of its clip and the name of the clip or group.
Changed = Callable[[Segment, str], Segment | None]


@dataclass(frozen=True)
class SegmentsResult:
    """Layers of a dataset with their numbers (`LayerNumbers`), the file that was written, and notes."""

    path: Path
    layers: tuple[Mapping[str, Any], ...]
    file: Path | None = None
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "path": str(self.path),
            "layers": list(self.layers),
            "file": None if self.file is None else str(self.file),
        }

    def __str__(self) -> str:
        notes = [f"note: {note}" for note in self.notes]
        if not self.layers:
            return "\n".join([f"{self.path} has no segments", *notes])
        names = ("name", "language", "author", "sided", "segments", "clips", "median_s", "coverage", "texts", "words")
        rows = [[_cell(layer[name]) for name in names] for layer in self.layers]
        lines = table(("layer", *names[1:]), rows)
        return "\n".join([*lines, *([f"written to {self.file}"] if self.file else []), *notes])


def _cell(value: Any) -> Any:
    return f"{value:.2f}" if isinstance(value, float) else "" if value is None else value


def segments(
    path: str | Path, *, to: str | Path | None = None, set_file: str | Path | None = None, layer: str | None = None
) -> SegmentsResult:
    """Summarise the segments of a dataset, write them to a file (`to`), or replace layers by those of a file."""
    folder = (local_folder(path) if set_file is None else Path(path).expanduser()).absolute()
    notes = () if set_file is None else _set(folder, Path(set_file).expanduser())
    with open_store(folder) as store:
        if layer is not None:
            store._require_layer(layer)
        file = None if to is None else Path(to).expanduser()
        if file is not None:
            _write(store, file, layer)
        numbers = [asdict(row) for row in store.layer_numbers() if layer in (None, row.name)]
        return SegmentsResult(folder, tuple(numbers), file, notes)


def _write(store: Store, file: Path, layer: str | None) -> None:
    if file.suffix.lower() not in _SUFFIXES or file.exists():
        raise UsageError("the file exists already" if file.exists() else "not a file of segments", where=file,
                         allowed="a new .csv or .jsonl", fix="choose another --out")  # fmt: skip
    clips = [(clip.id, segments) for clip in store if (segments := store.segments(clip.id, layer))]
    try:
        with atomic_file(file) as temporary:
            write_segment_file(temporary, clips, suffix=file.suffix)
    except OSError as error:
        raise UsageError(
            "the file cannot be written", where=file, found=str(error), fix="choose another --out"
        ) from error


def _set(folder: Path, file: Path) -> tuple[str, ...]:
    """Replace layers of a dataset. Return notes."""
    notes: list[str] = []

    def replaced(store: Store) -> dict[str, list[Segment]]:
        with open_store(folder, segments=file) as laid:
            overlay = laid.overlay
        assert overlay is not None  # noqa: S101 (that of the file)
        of_file = overlay.segments
        notes.extend(overlay.notes)
        copies, lexicons = _recipe(store)
        stored_layers: dict[tuple[Any, ...], Layer] = {
            (_layer_id(layer), layer.kind): layer for layer in store.layers
        }
        read = [[_with_labels_of(s, stored_layers) for s in segments] for segments in of_file.values()]
        stated = dict(zip(of_file, with_mirrored_words(read, lexicons), strict=True))
        new = {_layer_id(s.layer) for segments in stated.values() for s in segments}
        notes.extend(_lost(stated, store))
        return {
            clip.id: [
                *(s for s in store.segments(clip.id) if _layer_id(s.layer) not in new),
                *_of_clip(stated, store, clip, copies),
            ]
            for clip in store
        }

    rewrite_segments(folder, replaced)
    return tuple(notes)


def _lost(stated: Mapping[str, Sequence[Segment]], store: Store) -> list[str]:
    """Return a note on the segments that mirrored copies go without."""
    copied = {clip.source for clip in store if clip.id == f"{clip.source}__mirror" and clip.id not in stated}
    lost = [s.layer.name for clip in copied for s in stated.get(clip, ()) if not s.can_be_mirrored]
    if not lost:
        return []
    n = counted(len(lost), "segment")
    return [f"mirrored copies go without {n} of {listed(sorted(set(lost)))}: no lexicon of the language"]


def _with_labels_of(segment: Segment, by_name: Mapping[tuple[Any, ...], Layer]) -> Segment:
    """Return a segment whose layer also has the units and pairs of labels without a row, as the dataset has them."""
    layer = segment.layer
    earlier = by_name.get((_layer_id(layer), layer.kind))
    if earlier is None:
        return segment
    units = dict(earlier.units) | dict(layer.units)
    named = {label for pair in layer.mirror for label in pair}
    pairs = {pair for pair in earlier.mirror if not named & set(pair)} | set(layer.mirror)
    return replace(segment, layer=replace(layer, units=tuple(sorted(units.items())), mirror=tuple(sorted(pairs))))


def _layer_id(layer: Layer) -> tuple[str, str, str]:
    """Return what makes two layers the same one: name, language, author."""
    return layer.name, layer.language, layer.author


def _of_clip(
    stated: Mapping[str, Sequence[Segment]], store: Store, clip: Clip, copies: Mapping[str, Changed]
) -> Sequence[Segment]:
    """Return the segments of a file for a clip; of a copy without rows those of its clip, changed like the copy."""
    if clip.id in stated or clip.source not in stated:
        return stated.get(clip.id, ())
    changed = copies.get(clip.id.removeprefix(f"{clip.source}__"))
    if changed is None:
        raise UsageError("the segments of a copy cannot be made: what made the copy is not known",
                         where=f"clip {clip.id}", fix="add rows of the copy to the file")  # fmt: skip
    unit = store[clip.source].group or clip.source
    segments = (changed(segment, unit) for segment in stated[clip.source])
    return [segment for segment in segments if segment is not None]


def _recipe(store: Store) -> tuple[Mapping[str, Changed], Sequence[Lexicon]]:
    """Return what changes segments of copies, and lexicons, of a dataset's recipe; none if a plug-in is missing."""
    try:
        recipe = stored_recipe(store)
    except RecipeError:
        return {}, (ENGLISH,)
    lexicons = dict.fromkeys(lexicon for annotator in recipe.annotators for lexicon in annotator.lexicons)
    return {copy.name: copy.segment_of for copy in recipe.augment}, [*lexicons]

"""Scanned clips -> identified clips: hash motion files, decode and hash music."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from dancedata.building.inputs import RowsFile
from dancedata.building.plugins import Field
from dancedata.building.signals import SignalId, identify_audio
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import SourceError
from dancedata.core.hashing import json_sha256
from dancedata.core.plugins import Dataset
from dancedata.core.rejects import missing_music
from dancedata.core.text import counted, is_unicode, listed, quoted
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, in_reference, run_units
from dancedata.files.documents import content_hashes, document_of


@dataclass(frozen=True)
class SourceClip:
    """A clip whose files are identified."""

    ref: ClipRef
    motion_sha256: str
    signal: SignalId | None = None
    input_problem: Reject | None = None  # of its music, or of a file of rows; its motion is examined all the same
    files: Mapping[str, RowsFile] = field(default_factory=dict)  # those with rows, by field

    def inputs(self) -> tuple[list[Any], str, str | None]:
        """Return the clip's metadata, and the hashes of its motion and music."""
        ref = self.ref
        attributes = [ref.id, ref.split, ref.music, ref.tempo_bpm, ref.genre, ref.dancer, ref.lists, ref.declared]
        further = {
            "group": [ref.group, ref.member, ref.role] if ref.group else None,
            "keys": ref.keys,
            "columns": ref.columns,
            "audio_start": str(ref.audio_start) if ref.audio_start else None,
            "audio_start_by": ref.audio_start_by,
            "source": [str(t) for t in (ref.source_start, ref.source_end)]
            if ref.source_end or ref.source_start
            else None,
            "terms": [ref.licence, ref.citation] if ref.licence or ref.citation else None,
            "segments": json_sha256([repr(s) for s in ref.segments]) if ref.segments else None,
            "files": sorted((name, file.sha256) for name, file in self.files.items()),
        }
        stated = {name: value for name, value in further.items() if value}
        return (
            [*attributes, stated] if stated else attributes,
            self.motion_sha256,
            self.signal.sha256 if self.signal else None,
        )

    @cached_property
    def made_of(self) -> str:
        """First 12 digits of the hashes of motion file, decoded music and metadata; zeros without music."""
        attributes, motion, music = self.inputs()
        return "".join(digest[:12] for digest in (motion, music or "0" * 12, json_sha256(attributes)))


@dataclass(frozen=True)
class Sources:
    """An identified source folder."""

    scan: Scan
    clips: tuple[SourceClip, ...]  # those whose motion file could be hashed, in the order of the scan
    rejects: tuple[Reject, ...]  # also of clips without usable music
    content: Mapping[str, str]  # hashes of files that parameters name, of the dataset
    plugin_content: Mapping[str, str] = field(default_factory=dict)  # of other plug-ins

    @property
    def named_files(self) -> dict[str, str]:
        """SHA-256 of all files that the recipe names."""
        return {**self.content, **self.plugin_content}

    @property
    def sha256(self) -> str:
        """Hash of the clips, with the contents of their files, and of the rejects."""
        left_out = sorted([r.reason, r.clip, Path(r.file).name] for r in self.rejects)
        inputs = [clip.inputs() for clip in self.clips]
        numbers = {"genre_ids": dict(self.scan.genre_ids)} if self.scan.genre_ids else {}
        return json_sha256({"clips": inputs, "left_out": left_out, "content": self.named_files, **numbers})


def scan_source(dataset: Dataset, fields: Sequence[Field], source: Path) -> Scan:
    """List the clips of a source, generated before if need be; SourceError for ids that are there twice."""
    scan = in_reference(dataset.scan, source) if dataset.generates else dataset.scan(source)
    clips_by_id: dict[str, ClipRef] = {}
    for ref in scan.clips:
        other = clips_by_id.setdefault(ref.id, ref)
        if other is not ref:
            raise SourceError("two clips have the same id", where=f"dataset {dataset.name}, clip {ref.id}",
                              found=f"{other.motion_path} and {ref.motion_path}",
                              fix="rename one of them; clips of a dataset have different ids")  # fmt: skip
    _require_music(dataset, fields, scan)
    return replace(scan, clips=tuple(_with_paths(fields, ref, source) for ref in scan.clips))


def _require_music(dataset: Dataset, fields: Sequence[Field], scan: Scan) -> None:
    """Raise SourceError for clips that ``music: optional`` keeps, where fields are made of music."""
    without = [ref.id for ref in scan.clips if ref.audio_path is None]
    of_music = [field.name for field in fields if field.needs_music]
    if of_music and without and document_of(dataset).get("music") == "optional":
        found = f"{len(without)} of {counted(len(scan.clips), 'clip')} without music: {listed(without)}"
        raise SourceError("music: optional keeps clips without music; audio features need the music of every clip",
                          where=f"dataset {dataset.name}", found=f"{found}; audio features {listed(of_music)}",
                          fix="build motion alone: --set 'audio={}'; or leave these clips out: "
                          f"--set dataset.{dataset.name}.music=required")  # fmt: skip


def _with_paths(fields: Sequence[Field], ref: ClipRef, source: Path) -> ClipRef:
    for of_clip in fields:
        ref = of_clip.with_path(ref, source)
    return ref


def identify(
    cache: Cache,
    dataset: Dataset,
    fields: Sequence[Field],
    scan: Scan,
    *,
    jobs: Jobs,
    progress: Progress,
    hash_music: Callable[[Cache, Path], SignalId | Reject] = identify_audio,
    hash_rows: Callable[[Cache, Path], str] = Cache.file_sha256,
) -> Sources:
    """Hash motion files, music and files of rows; a plan gives functions that only look the last two up."""
    content = content_hashes(dataset, cache.file_sha256)
    named, rejects = _with_valid_names(scan.clips)
    hashes = _hash_motion(cache, named, progress)
    rejects += [replace(sha, clip=ref.id) for ref in named if isinstance(sha := hashes[ref.motion_path], Reject)]
    refs = [(ref, sha) for ref in named if isinstance(sha := hashes[ref.motion_path], str)]
    signals: dict[Path, SignalId | Reject] | None = None
    if any(field.needs_music for field in fields):
        signals = _identify_music(cache, [ref for ref, _ in refs], hash_music, jobs, progress)
    clips = [_identified(cache, fields, ref, sha, signals, hash_rows) for ref, sha in refs]
    rejects += [clip.input_problem for clip in clips if clip.input_problem is not None]
    return Sources(scan, tuple(clips), (*scan.rejects, *rejects), content)


def _with_valid_names(clips: Sequence[ClipRef]) -> tuple[list[ClipRef], list[Reject]]:
    """Reject clips whose names are not valid Unicode."""
    valid, rejects = [], []
    for ref in clips:
        texts = (ref.id, ref.split, ref.music, ref.genre, ref.dancer, *ref.lists)
        wrong = [text for text in texts if not is_unicode(text)]
        if not wrong:
            valid.append(ref)
            continue
        detail = f"clip {ref.id}: {quoted(wrong[0])} is not valid Unicode; rename the file, or correct what names it"
        rejects.append(Reject("bad_name", ref.id, str(ref.motion_path), detail=detail))
    return valid, rejects


def _hash_motion(cache: Cache, refs: Sequence[ClipRef], progress: Progress) -> dict[Path, str | Reject]:
    paths = list(dict.fromkeys(ref.motion_path for ref in refs))
    calls = [(cache, path) for path in paths]
    cached = [_cached_hash(cache, path) for path in paths]
    hashes = run_units(
        _hash_file, calls, cached=cached, jobs=1, label="hashing motion", progress=progress, exact=False
    )
    return dict(zip(paths, hashes, strict=True))


def _hash_file(cache: Cache, path: Path) -> str | Reject:
    try:
        return cache.hashed_sha256(path)
    except OSError as error:
        return Reject("broken_file", file=str(path), detail=f"{path}: {error}")


def _cached_hash(cache: Cache, path: Path) -> str | None:
    """Return the cached result of `_hash_file`, None if there is none."""
    try:
        return cache.cached_sha256(path)
    except OSError:
        return None


def _identify_music(
    cache: Cache,
    refs: Sequence[ClipRef],
    hash_music: Callable[[Cache, Path], SignalId | Reject],
    jobs: Jobs,
    progress: Progress,
) -> dict[Path, SignalId | Reject]:
    paths = sorted({ref.audio_path for ref in refs if ref.audio_path is not None})
    cached = [SignalId.cached(cache, path) for path in paths]
    calls = [(cache, path) for path in paths]
    signals = run_units(hash_music, calls, cached=cached, jobs=jobs, label="decoding music", progress=progress)
    return dict(zip(paths, signals, strict=True))


def _identified(
    cache: Cache,
    fields: Sequence[Field],
    ref: ClipRef,
    sha256: str,
    signals: Mapping[Path, SignalId | Reject] | None,
    hash_rows: Callable[[Cache, Path], str],
) -> SourceClip:
    """Return a clip with its music and its files of rows, or with why one cannot be used."""
    signal: SignalId | Reject | None = None
    if signals is not None:
        signal = missing_music(ref) if ref.audio_path is None else signals[ref.audio_path]
    files = {field.name: field.file_of(cache, ref, hash_rows) for field in fields}
    problems = [problem for problem in (signal, *files.values()) if isinstance(problem, Reject)]
    if problems:
        return SourceClip(ref, sha256, input_problem=replace(problems[0], clip=ref.id))
    of_fields = {name: file for name, file in files.items() if isinstance(file, RowsFile)}
    return SourceClip(ref, sha256, signal if isinstance(signal, SignalId) else None, files=of_fields)

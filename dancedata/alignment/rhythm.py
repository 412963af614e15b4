"""Offsets of music against motion, of clips together: units of work, and clips whose offset a build finds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dancedata.alignment.onsets import onset_strength
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import DataError
from dancedata.core.hashing import json_sha256
from dancedata.core.plugins import Dataset
from dancedata.core.registry import STARTS
from dancedata.core.rejects import changed, reject_of
from dancedata.core.text import counted
from dancedata.core.typing import override
from dancedata.files.documents import clip_identity, content_hashes, document_of
from dancedata.files.regular_file import sha256_file
from dancedata.kernel import Cache, CachedArray, Executor, Progress, SignalId, StartFinder, identify_audio, run_units
from dancedata.metrics.offsets import RATE, REASONS, Offset, RhythmPiece, find_offset, music_rhythm, rhythm_curves

#: Raised by hand when onsets, curves or offsets of the same input change.
VERSION = 1
#: Most other songs of a null distribution.
_MOST_SONGS = 64
_NO_MUSIC = Reject("missing_music", detail="the clip has no music")


@dataclass(frozen=True)
class Search:
    """Parameters of the search for offsets; see `find_offset`."""

    window_s: float = 0.5
    level: float = 0.02
    test_songs: bool = False
    seed: int = 0


@dataclass(frozen=True)
class OffsetGroup:
    """Clips that have one offset."""

    name: str
    clips: tuple[ClipRef, ...]


def recordings(clips: Sequence[ClipRef]) -> list[OffsetGroup]:
    """Group clips by recording: dancers of a group, or parts and people of one motion file, with one music file."""
    by_recording: dict[tuple[str | Path, Path | None], list[ClipRef]] = {}
    for clip in clips:
        by_recording.setdefault((clip.group or clip.motion_path, clip.audio_path), []).append(clip)
    return [
        OffsetGroup(of[0].id if len(of) == 1 else of[0].group or of[0].motion_path.name, tuple(of))
        for of in by_recording.values()
    ]


def find_offsets(
    cache: Cache,
    dataset: Dataset,
    units: Sequence[OffsetGroup],
    songs: Sequence[Path],
    search: Search,
    *,
    jobs: int | Executor,
    progress: Progress,
) -> tuple[list[Offset | Reject], list[Reject]]:
    """Return the offset of each unit, a reject where no clip of it can be used, and the rejects of clips."""
    clips = [clip for unit in units for clip in unit.clips]
    paths = {clip.audio_path for clip in clips if clip.audio_path is not None}
    music, unheard = _all_music(cache, sorted(paths), songs, jobs, progress)
    curves, rejects = _all_curves(cache, dataset, clips, jobs, progress)
    rejects += [replace(unheard.get(c.audio_path, _NO_MUSIC), clip=c.id) for c in clips if c.audio_path not in music]
    problems = {reject.clip: reject for reject in rejects}
    calls: dict[int, tuple[Any, ...]] = {}
    for number, unit in enumerate(units):
        usable = [clip for clip in unit.clips if clip.id not in problems]
        pieces = [(curves[clip.id], music[clip.audio_path].rows, float(clip.audio_start)) for clip in usable]
        own = {music[clip.audio_path].sha256 for clip in usable}
        others = {song.sha256: song.rows for song in music.values() if song.sha256 not in own}
        null = [others[sha256] for sha256 in sorted(others)[:_MOST_SONGS]]
        tempos = {clip.tempo_bpm for clip in usable}
        if pieces:
            tempo_bpm = tempos.pop() if len(tempos) == 1 else None
            calls[number] = (cache, pieces, null, search, tempo_bpm, unit.name)
    entries = [cache.json("offsets", _offset_key(*call[1:])) for call in calls.values()]
    cached = [None if entry is None else Offset(**entry) for entry in entries]
    found = run_units(
        _find, list(calls.values()), cached=cached, jobs=jobs, label="finding offsets", progress=progress
    )
    offsets = dict(zip(calls, found, strict=True))
    return [offsets.get(n) or problems[unit.clips[0].id] for n, unit in enumerate(units)], rejects


@dataclass(frozen=True, eq=False)
class _Song:
    """The rhythm of a song, and the hash of its samples."""

    sha256: str
    rows: CachedArray


def _all_music(
    cache: Cache, paths: Sequence[Path], songs: Sequence[Path], jobs: int | Executor, progress: Progress
) -> tuple[dict[Path | None, _Song], dict[Path | None, Reject]]:
    """Return the rhythm of the songs at `paths` and of some of `songs`, and the rejects of unusable ones."""
    everything = sorted({*paths, *songs})
    identified = run_units(
        identify_audio, [(cache, path) for path in everything],
        cached=[SignalId.cached(cache, path) for path in everything], jobs=jobs, label="decoding music",
        progress=progress,
    )  # fmt: skip
    problems: dict[Path | None, Reject] = {
        path: found for path, found in zip(everything, identified, strict=True) if isinstance(found, Reject)
    }
    signals = sorted((s for s in identified if isinstance(s, SignalId)), key=lambda s: (s.sha256, s.path))
    first = set(sorted({s.sha256 for s in signals})[: _MOST_SONGS + 1])
    signals = [s for s in signals if s.path in set(paths) or s.sha256 in first]
    keys = [Cache.numeric_key("onsets", version=VERSION, signal=signal.sha256) for signal in signals]
    computed = run_units(
        _onsets, [(cache, signal, key) for signal, key in zip(signals, keys, strict=True)],
        cached=[cache.array("onsets", key) for key in keys], jobs=jobs, label="rhythm of music", progress=progress,
    )  # fmt: skip
    music: dict[Path | None, _Song] = {}
    for signal, rows in zip(signals, computed, strict=True):
        if isinstance(rows, Reject):
            problems[signal.path] = rows
        else:
            music[signal.path] = _Song(signal.sha256, rows)
    return music, problems


def _all_curves(
    cache: Cache, dataset: Dataset, clips: Sequence[ClipRef], jobs: int | Executor, progress: Progress
) -> tuple[dict[str, CachedArray], list[Reject]]:
    content = content_hashes(dataset, cache.file_sha256)
    loading = [dataset.name, dataset.version, document_of(dataset, loading=True), dict(content)]
    common = Cache.numeric_key("rhythm", version=VERSION, dataset=loading)
    curves, calls, rejects = dict[str, CachedArray](), [], []
    for clip in clips:
        try:
            sha256 = cache.file_sha256(clip.motion_path)
        except OSError as error:
            detail = f"{clip.motion_path}: {error}"
            rejects.append(Reject("broken_file", clip.id, str(clip.motion_path), detail=detail))
            continue
        key = Cache.key("rhythm", common=common, clip=clip_identity(clip), file=sha256)
        calls.append((cache, dataset, clip, sha256, key))
    computed = run_units(
        _curves, calls, cached=[cache.array("rhythm", call[-1]) for call in calls], jobs=jobs,
        label="rhythm of motion", progress=progress,
    )  # fmt: skip
    for call, rows in zip(calls, computed, strict=True):
        if isinstance(rows, Reject):
            rejects.append(rows)
        else:
            curves[call[2].id] = rows
    return curves, rejects


def _onsets(cache: Cache, signal: SignalId, key: str) -> CachedArray | Reject:
    try:
        return cache.once("onsets", key, lambda: music_rhythm(onset_strength(signal.load(), RATE)))
    except DataError as error:
        return reject_of(error, file=signal.path)


def _curves(cache: Cache, dataset: Dataset, clip: ClipRef, sha256: str, key: str) -> CachedArray | Reject:
    def compute() -> Any:
        motion = dataset.load(clip)
        if sha256_file(clip.motion_path) != sha256:
            raise changed(clip.motion_path)
        return rhythm_curves(motion.joints(), float(motion.grid.rate), motion.skeleton.joints)

    try:
        return cache.once("rhythm", key, compute)
    except DataError as error:
        return reject_of(error, clip=clip.id, file=clip.motion_path)


#: Curves, the music's rhythm and its stated second.
_Piece = tuple[CachedArray, CachedArray, float]


def _offset_key(
    pieces: Sequence[_Piece], others: Sequence[CachedArray], search: Search, tempo_bpm: float | None, name: str
) -> str:
    # Names of entries are their keys.
    of_pieces = [[curves.path.name, music.path.name, start] for curves, music, start in pieces]
    return Cache.key(
        "offset", version=VERSION, pieces=of_pieces, others=[song.path.name for song in others],
        search=asdict(search), bpm=tempo_bpm, name=name,
    )  # fmt: skip


def _find(
    cache: Cache,
    pieces: Sequence[_Piece],
    others: Sequence[CachedArray],
    search: Search,
    tempo_bpm: float | None,
    name: str,
) -> Offset:
    seed = int(json_sha256([search.seed, name])[:16], 16)
    rhythm = [RhythmPiece(np.asarray(curves), np.asarray(music), start) for curves, music, start in pieces]
    offset = find_offset(
        rhythm, [np.asarray(other) for other in others], window_s=search.window_s, level=search.level,
        tempo_bpm=tempo_bpm, test_songs=search.test_songs, seed=seed,
    )  # fmt: skip
    cache.put_json("offsets", _offset_key(pieces, others, search, tempo_bpm, name), asdict(offset))
    return offset


def found_start(stated: Fraction, offset: Offset) -> Fraction:
    """Return the second of the music at frame 0 with an offset, which is known to a millisecond at best."""
    return stated + Fraction(round(1000 * (offset.offset_s or 0.0)), 1000)


def about_offset(offset: Offset) -> str:
    """Return the numbers of an offset as a text."""
    if offset.offset_s is None or offset.width_s is None or offset.p is None:
        return f"{offset.seconds:.1f} s of motion"
    rivals = f", {counted(offset.rivals, 'other song')} that {'fits' if offset.rivals == 1 else 'fit'} too"
    return (
        f"{1000 * offset.offset_s:+.0f} +- {1000 * offset.width_s:.0f} ms, p {offset.p:.3f}"
        f"{rivals if offset.rivals else ''}"
    )


@STARTS.register("align")
@dataclass(frozen=True)
class AlignedStarts(StartFinder):
    """The offsets of `dancedata check --offsets`; clips of one recording have one."""

    version: ClassVar[int] = VERSION

    @override
    def find(
        self,
        cache: Cache,
        dataset: Dataset,
        scan: Scan,
        asked: Sequence[ClipRef],
        *,
        jobs: int | Executor,
        progress: Progress,
    ) -> Scan:
        units = recordings(asked)
        songs = sorted({clip.audio_path for clip in scan.clips if clip.audio_path is not None})
        offsets, _ = find_offsets(cache, dataset, units, songs, Search(), jobs=jobs, progress=progress)
        placed: dict[str, ClipRef | None] = {clip.id: clip for clip in scan.clips}
        rejects, known = list(scan.rejects), 0
        for unit, offset in zip(units, offsets, strict=True):
            known += isinstance(offset, Offset) and not offset.unknown
            for clip in unit.clips:
                if isinstance(offset, Reject):
                    placed[clip.id] = None
                    rejects.append(replace(offset, clip=clip.id))
                elif offset.unknown:
                    placed[clip.id] = None
                    rejects.append(_unknown(clip, unit, offset))
                else:
                    by = f"align {VERSION}: {about_offset(offset)}, of {counted(len(unit.clips), 'clip')}"
                    start = found_start(clip.audio_start, offset)
                    placed[clip.id] = replace(clip, audio_start=start, audio_start_by=by)
        note = f"Music: audio_start_s auto was found for {known} of {counted(len(units), 'recording')}."
        clips = tuple(clip for clip in placed.values() if clip is not None)
        return replace(scan, clips=clips, rejects=tuple(rejects), notes=(*scan.notes, note))


def _unknown(clip: ClipRef, unit: OffsetGroup, offset: Offset) -> Reject:
    numbers: Mapping[str, float | None] = {
        "offset_s": offset.offset_s, "width_s": offset.width_s, "p": offset.p, "seconds": offset.seconds,
    }  # fmt: skip
    return Reject(
        "unknown_offset",
        clip.id,
        detail=f"audio_start_s is auto, but the offset of {unit.name} is unknown: {REASONS[offset.unknown]} "
        f"({about_offset(offset)}); write the seconds, such as 0, in the manifest",
        numbers={name: round(value, 4) for name, value in numbers.items() if value is not None},
    )

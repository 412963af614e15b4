"""From a source folder to clips ready to store: identify, encode, extract; nothing is dropped silently."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import StoreError
from dancedata.core.hashing import json_sha256
from dancedata.core.windows import count_windows, window_starts
from dancedata.pipeline.cache import Cache, CachedArray
from dancedata.pipeline.execute import Progress, run_units
from dancedata.pipeline.recipe import Recipe
from dancedata.pipeline.units import (
    MotionResult,
    SignalId,
    encode_motion,
    extract_track,
    extract_windows,
    hash_motion,
    identify_audio,
    motion_window_count,
    window_key,
    window_samples,
)
from dancedata.store import AudioBlock, StoredClip


@dataclass
class Gathered:
    """What a build knows so far.

    Attributes
    ----------
    refs
        Clips still in the build, by id.
    rejects
        All that was left out.
    motion_sha, signals
        Identity of every clip's files.
    """

    recipe: Recipe
    scan: Scan
    refs: dict[str, ClipRef]
    rejects: list[Reject]
    motion_sha: dict[str, str] = field(default_factory=dict)
    signals: dict[Path, SignalId] = field(default_factory=dict)
    quality: list[dict[str, Any]] = field(default_factory=list)

    def drop(self, clip: str, reject: Reject) -> None:
        """Set a clip aside."""
        self.refs.pop(clip, None)
        self.rejects.append(reject if reject.clip else replace(reject, clip=clip))

    def signal(self, ref: ClipRef) -> SignalId | None:
        """Return the identity of a clip's music."""
        return self.signals.get(ref.audio_path) if ref.audio_path is not None else None

    def source_sha256(self) -> str:
        """Return a hash of all that went in: clips with their files' contents, and what was left out."""
        clips = []
        for ref in self.refs.values():
            signal = self.signal(ref)
            clips.append(
                [
                    [ref.id, ref.split, ref.music, ref.tempo_bpm, ref.genre, ref.dancer, list(ref.lists)],
                    self.motion_sha[ref.id],
                    signal.sha256 if signal else None,
                ]
            )
        left_out = sorted([r.reason, r.clip, Path(r.file).name] for r in self.rejects)
        return json_sha256({"clips": clips, "left_out": left_out})


def identify(cache: Cache, recipe: Recipe, scan: Scan, *, jobs: int, progress: Progress) -> Gathered:
    """Find out what every clip's files are: hash motions, decode and hash music."""
    gathered = Gathered(recipe, scan, {r.id: r for r in scan.clips}, list(scan.rejects))
    refs = list(scan.clips)
    hashes = run_units(hash_motion, [(cache, r) for r in refs], jobs=1, label="hashing motion", progress=progress)
    for ref, sha in zip(refs, hashes, strict=True):
        if isinstance(sha, Reject):
            gathered.drop(ref.id, sha)
        else:
            gathered.motion_sha[ref.id] = sha
    if recipe.audio:
        _identify_music(cache, gathered, jobs, progress)
    return gathered


def _identify_music(cache: Cache, gathered: Gathered, jobs: int, progress: Progress) -> None:
    paths = sorted({r.audio_path for r in gathered.refs.values() if r.audio_path is not None})
    calls = [(cache, gathered.recipe, path) for path in paths]
    found = run_units(identify_audio, calls, jobs=jobs, label="decoding music", progress=progress)
    outcome = dict(zip(paths, found, strict=True))
    gathered.signals = {p: o for p, o in outcome.items() if isinstance(o, SignalId)}
    for ref in list(gathered.refs.values()):
        result = outcome.get(ref.audio_path) if ref.audio_path is not None else None
        if result is None:
            gathered.drop(ref.id, Reject("missing_music", clip=ref.id, detail=f"no music for clip {ref.id}"))
        elif isinstance(result, Reject):
            gathered.drop(ref.id, result)


def gather(cache: Cache, gathered: Gathered, *, jobs: int, progress: Progress) -> list[StoredClip]:
    """Encode all motion and extract all features; returns the clips to store, sorted by id."""
    motions = _encode_all(cache, gathered, jobs, progress)
    starts = {clip: _starts(gathered, clip, motion) for clip, motion in motions.items()}
    for clip, motion in motions.items():
        if not starts[clip]:
            gathered.drop(clip, _too_short(gathered, gathered.refs[clip], motion))
    audio = _extract_all(cache, gathered, starts, jobs, progress)
    clips = []
    for clip in sorted(audio):
        motion, ref, n = motions[clip], gathered.refs[clip], len(starts[clip])
        arrays = motion.arrays
        if gathered.recipe.scope == "window":
            arrays = {name: array.head(n) for name, array in arrays.items()}
        gathered.quality += [{"clip": clip, **flag} for flag in motion.flags]
        clips.append(_stored(ref, motion, starts[clip], arrays, audio[clip]))
    return clips


def _stored(
    ref: ClipRef,
    motion: MotionResult,
    starts: tuple[int, ...],
    arrays: dict[str, CachedArray],
    audio: dict[str, tuple[AudioBlock, ...]],
) -> StoredClip:
    return StoredClip(
        id=ref.id,
        split=ref.split,
        genre=ref.genre,
        music=ref.music,
        dancer=ref.dancer,
        tempo_bpm=ref.tempo_bpm,
        n_flags=len(motion.flags),
        lists=ref.lists,
        n_frames=motion.n_frames,
        starts=starts,
        motion=arrays,
        audio=audio,
    )


def _encode_all(cache: Cache, gathered: Gathered, jobs: int, progress: Progress) -> dict[str, MotionResult]:
    refs = list(gathered.refs.values())
    calls = [(cache, gathered.recipe, r, gathered.motion_sha[r.id]) for r in refs]
    motions = {}
    results = run_units(encode_motion, calls, jobs=jobs, label="encoding motion", progress=progress)
    for ref, result in zip(refs, results, strict=True):
        if isinstance(result, Reject):
            gathered.drop(ref.id, result)
        else:
            motions[ref.id] = result
    return motions


def audio_window_count(recipe: Recipe, n_samples: int, sample_rate: int) -> int:
    """Return how many windows a signal has: whole windows of samples, or of every feature's rows (track scope)."""
    length, stride = recipe.windows.length, recipe.windows.stride
    if recipe.scope == "window":
        samples, step = window_samples(recipe, sample_rate)
        return count_windows(n_samples, samples, step) if samples and step else 0
    rows = [f.n_rows(n_samples, sample_rate, recipe.grid) for f in recipe.audio]
    return min(count_windows(n, length, stride) for n in rows)


def _starts(gathered: Gathered, clip: str, motion: MotionResult) -> tuple[int, ...]:
    """Return the window starts of a clip, at the recipe's rate; windows without music become rejects."""
    recipe = gathered.recipe
    count = motion_window_count(recipe, motion.n_source, motion.source_rate)
    signal = gathered.signal(gathered.refs[clip])
    if recipe.audio and signal is not None:
        with_music = audio_window_count(recipe, signal.n_samples, signal.sample_rate)
        for k in range(with_music, count):
            numbers = {"audio_s": round(signal.n_samples / signal.sample_rate, 3)}
            detail = f"window {k} reaches beyond the end of {signal.path.name}"
            start = k * recipe.windows.stride
            gathered.rejects.append(Reject("no_audio", clip=clip, window=start, detail=detail, numbers=numbers))
        count = min(count, with_music)
    last = count * recipe.windows.stride + recipe.windows.length - recipe.windows.stride
    return tuple(int(s) for s in window_starts(last, recipe.windows.length, recipe.windows.stride)) if count else ()


def _too_short(gathered: Gathered, ref: ClipRef, motion: MotionResult) -> Reject:
    recipe = gathered.recipe
    signal = gathered.signal(ref)
    motion_s = float(motion.n_source / motion.source_rate)
    numbers: dict[str, float | int] = {"motion_s": round(motion_s, 3)}
    detail = f"{motion.n_source} frames at {motion.source_rate} a second ({motion_s:.2f} s)"
    if signal is not None:
        seconds = signal.n_samples / signal.sample_rate
        numbers["audio_s"] = round(seconds, 3)
        detail += f", {seconds:.2f} s of music"
    window_s = float(recipe.windows.length / recipe.fps)
    detail = f"clip {ref.id} has no whole window: {detail}; a window has {window_s:.2f} s"
    return Reject("too_short", clip=ref.id, file=str(ref.motion_path), detail=detail, numbers=numbers)


def _extract_all(
    cache: Cache, gathered: Gathered, starts: dict[str, tuple[int, ...]], jobs: int, progress: Progress
) -> dict[str, dict[str, tuple[AudioBlock, ...]]]:
    """Return per clip and feature the blocks of rows; clips whose music fails are set aside."""
    audio: dict[str, dict[str, tuple[AudioBlock, ...]]] = {clip: {} for clip in gathered.refs}
    for feature in gathered.recipe.audio:
        extract = _extract_tracks if gathered.recipe.scope == "track" else _extract_windows
        found = extract(cache, gathered, feature, starts, jobs, progress)
        for clip, blocks in found.items():
            audio[clip][feature.name] = blocks
    return {clip: blocks for clip, blocks in audio.items() if clip in gathered.refs}


def _extract_tracks(
    cache: Cache,
    gathered: Gathered,
    feature: Any,
    starts: dict[str, tuple[int, ...]],
    jobs: int,
    progress: Progress,
) -> dict[str, tuple[AudioBlock, ...]]:
    timelines: dict[tuple[str, float | None], list[str]] = {}
    signals: dict[str, SignalId] = {}
    for ref in gathered.refs.values():
        signal = _need_signal(gathered, ref)
        signals.setdefault(signal.sha256, signal)
        timelines.setdefault((signal.sha256, ref.tempo_bpm), []).append(ref.id)
    calls = [(cache, gathered.recipe, feature, signals[sha], bpm) for sha, bpm in timelines]
    results = run_units(extract_track, calls, jobs=jobs, label=feature.name, progress=progress)
    found: dict[str, tuple[AudioBlock, ...]] = {}
    for clips, result in zip(timelines.values(), results, strict=True):
        for clip in clips:
            if isinstance(result, Reject):
                gathered.drop(clip, result)
            else:
                found[clip] = (AudioBlock(result[0], result[1]),)
    return found


def _extract_windows(
    cache: Cache,
    gathered: Gathered,
    feature: Any,
    starts: dict[str, tuple[int, ...]],
    jobs: int,
    progress: Progress,
) -> dict[str, tuple[AudioBlock, ...]]:
    """Windows of equal samples and tempo are computed once, whatever files and clips they are in."""
    recipe = gathered.recipe
    owner: dict[str, tuple[Path, float | None]] = {}
    wanted: dict[tuple[Path, float | None], list[int]] = {}
    for ref in gathered.refs.values():
        signal = _need_signal(gathered, ref)
        for number in range(len(starts[ref.id])):
            key = window_key(recipe, feature, ref.tempo_bpm, signal.windows[number])
            if key not in owner:
                owner[key] = signal.path, ref.tempo_bpm
                wanted.setdefault(owner[key], []).append(number)
    calls = [
        (cache, recipe, feature, gathered.signals[path], bpm, numbers[i : i + 8])
        for (path, bpm), numbers in wanted.items()
        for i in range(0, len(numbers), 8)
    ]
    results = run_units(extract_windows, calls, jobs=jobs, label=feature.name, progress=progress)
    arrays: dict[str, CachedArray] = {}
    failed: dict[Path, Reject] = {}
    for call, result in zip(calls, results, strict=True):
        if isinstance(result, Reject):
            failed[call[3].path] = result
        else:
            arrays.update({key: array for key, array in result.values()})
    found: dict[str, tuple[AudioBlock, ...]] = {}
    for ref in list(gathered.refs.values()):
        signal = _need_signal(gathered, ref)
        keys = [window_key(recipe, feature, ref.tempo_bpm, w) for w in signal.windows[: len(starts[ref.id])]]
        missing = [k for k in keys if k not in arrays]
        if missing:
            gathered.drop(ref.id, failed[owner[missing[0]][0]])
        else:
            found[ref.id] = tuple(AudioBlock(k, arrays[k]) for k in keys)
    return found


def _need_signal(gathered: Gathered, ref: ClipRef) -> SignalId:
    signal = gathered.signal(ref)
    if signal is None:
        raise StoreError("a clip without music reached the audio features", where=f"clip {ref.id}")
    return signal


def require_clips(clips: Sequence[StoredClip], rejects: Sequence[Reject]) -> None:
    """Raise StoreError if nothing is left to store, saying why the clips were left out."""
    if clips:
        return
    reasons: dict[str, Reject] = {}
    for reject in rejects:
        reasons.setdefault(reject.reason, reject)
    lines = "\n".join(f"  - {name}: {r.detail or r.clip or r.file}" for name, r in sorted(reasons.items()))
    raise StoreError(f"no clip is left to build from; every one was left out, for instance\n{lines}")
